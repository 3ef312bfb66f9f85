"""Merged maps of components, matched again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust import RobustSettings, match, prepare
from topobatch.merge.robust.components import Components, as_alignment
from topobatch.merge.robust.pairing import Pairwise
from topobatch.merge.robust.rematching import MergedMaps, Rematcher
from topobatch.merge.robust.repetition import default_copies
from topobatch.merge.robust.verdict import Threshold
from topobatch.topology.se2 import inverse

SETTINGS = RobustSettings()
EXACT = {"centre_m": 0.02, "branch_rad": 0.02, "bend_m": 0.0, "missed": 0.0, "branch_fault": -1.0}
PAIRS = ((0, 1), (0, 2), (1, 2))


@pytest.fixture(scope="module")
def three(maze, see):
    """Three sectors of a maze; each two of them share another part of it."""
    x, y = (maze.xy - maze.xy.mean(axis=0)).T
    angle = np.degrees(np.arctan2(y, x)) % 360
    return [
        see(maze, np.flatnonzero((angle - first) % 360 < 190).tolist(), k, name, **EXACT)
        for k, (name, first) in enumerate((("a", 0), ("b", 120), ("c", 240)))
    ]


@pytest.fixture(scope="module")
def found(three):
    """What matching two of them finds."""
    ready = [prepare(m) for m in three]
    return {(i, j): match(ready[i], ready[j], SETTINGS) for i, j in PAIRS}


def rematched(three, found, need_bits, never=(), asked=None, **others):
    """The components and their matches where the first two are joined and merging needs so much.
    asked: to be told of what runs, among how many pairs, that was asked; others: of the
    `Rematcher`."""
    threshold = Threshold(need_bits, 0.0, 0.0, default_copies(SETTINGS), SETTINGS)

    def level_of(runs, pairs):
        if asked is not None:
            asked.append((tuple(runs), pairs))
        return threshold

    parts = Components(3, never)
    first = found[0, 1][0]
    parts.join(0, 1, first.transform)
    rematcher = Rematcher(Pairwise(three, SETTINGS), parts, PAIRS, level_of, **others)
    return parts, rematcher.run({(0, 1): as_alignment(first)})


def test_two_merged_runs_say_of_a_third_what_neither_says_alone(three, found):
    alone = max(found[pair][0].counted_bits for pair in ((0, 2), (1, 2)))
    parts, matches = rematched(three, found, alone + 5.0)
    assert parts.together(0, 2)
    assert set(matches) == {(0, 2), (1, 2)}
    for match_ in matches.values():
        assert match_.alignment.evidence_bits >= alone + 5.0
        assert match_.sides == (("a", "b"), ("c",))
        assert "together with" in match_.reason


def test_components_are_joined_as_locks_name_their_junctions_or_not_at_all(three, found):
    _, matches = rematched(three, found, 15.0)
    (u, v), (_, w) = matches[1, 2].alignment.matched[:2].tolist()
    parts, honoured = rematched(three, found, 15.0, unmet={(1, 2): (u, v)})
    assert parts.together(0, 2)
    assert set(honoured) == {(0, 2), (1, 2)}
    parts, others = rematched(three, found, 15.0, unmet={(1, 2): (u, w)})
    assert not parts.together(0, 2)
    assert others == {}


def test_a_merged_map_does_not_depend_on_the_names_of_its_runs(three, found):
    """Their order is that of their names, so that another name changed frame and verdict."""
    a, b, _ = three
    T = as_alignment(found[0, 1][0])
    back = replace(T, transform=inverse(T.transform), matched=T.matched[:, ::-1])
    one = MergedMaps(Pairwise([a, b], SETTINGS)).of((0, 1), {(0, 1): T})
    other = [replace(b, run="1"), replace(a, run="2")]
    two = MergedMaps(Pairwise(other, SETTINGS)).of((0, 1), {(0, 1): back})
    np.testing.assert_allclose(one.as_map.xy, two.as_map.xy, atol=1e-6)
    assert [sorted(m.values()) for m in one.members] == [sorted(m.values()) for m in two.members]
    assert one.order == two.order
