"""Candidate alignments of two maps, with their evidence."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.codec import to_bytes
from topobatch.merge.robust.alignment import match, match_all, same_matches, same_placement
from topobatch.merge.robust.prepare import prepare
from topobatch.topology.se2 import inverse

from .plans import EDGES, POINTS, SETTINGS
from .rooms import views_of, walls_of


def test_pairs_are_matched_together_as_each_would_be_alone(halves, drawn):
    """To the last bit: what a task holds, and so how work is divided, changes nothing."""
    more = [*POINTS, (8.5, -6)]
    split = [e for e in EDGES if e != (3, 4)] + [(3, 8), (8, 4)]
    small = [drawn("a", POINTS, EDGES), drawn("b", more, split, stubs=[(8, -1.57)])]
    maps = [prepare(m) for m in (*small, *halves)]
    pairs = [(a, b) for a in maps for b in maps]
    together = list(match_all(pairs, SETTINGS))
    assert [to_bytes(found) for found in together] == [
        to_bytes(match(a, b, SETTINGS)) for a, b in pairs
    ]
    assert sum(len(found) > 0 for found in together) >= 8
    assert list(match_all([], SETTINGS)) == []


def test_what_a_match_is_made_of_adds_up(halves):
    a, b = (prepare(m) for m in halves)
    for found in match(a, b, SETTINGS):
        agree = found.support
        assert len(agree.links) == len(agree.ends) == len(agree.along)
        assert len(agree.branches) == len(found)
        total = agree.links.sum() + agree.branches.sum() - found.conflicts.bits - found.tested_bits
        assert total == pytest.approx(found.bits, abs=1e-9)
        corridors = agree.corridors[agree.along[agree.along >= 0]]
        ends = {frozenset(found.a[pair].tolist()) for pair in agree.ends[agree.along >= 0]}
        rows = zip(a.tail[corridors[:, 0]], a.head[corridors[:, 0]], strict=True)
        assert {frozenset(map(int, row)) for row in rows} == ends


def test_views_judge_what_junctions_propose(halves):
    """Views of one place raise the evidence of the true placement, those of another lower it."""
    left, right = halves
    before = match(prepare(left), prepare(right), SETTINGS)[0]
    walls = walls_of(1, size_m=80.0) - np.tile([20.0, 20.0], 2)
    others = walls_of(2, size_m=80.0) - np.tile([20.0, 20.0], 2)
    places = left.xy[before.a]
    back = inverse(before.transform)
    seen = replace(left, views=views_of(walls, places))
    for world, better in ((walls, True), (others, False)):
        beside = replace(right, views=views_of(world, places, tuple(back.tolist())))
        after = match(prepare(seen), prepare(beside), SETTINGS)
        same = next(c for c in after if same_placement(c, before, prepare(right)))
        assert len(same.views) > 0
        exchanged = [c.exchanged() for c in match(prepare(beside), prepare(seen), SETTINGS)]
        assert [c.bits for c in exchanged] == [c.bits for c in after]
        assert all(map(same_matches, exchanged, after))
        assert (same.views.total > 10) == better
        assert (same.bits > before.bits) == better
