"""Copies of one design, and what tells them from the place itself."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust.alignment import match, self_matches
from topobatch.merge.robust.conflicts import NO_CONFLICTS
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.repetition import SHARES, copy_model, sameness
from topobatch.merge.robust.support import NO_SUPPORT
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import wrap

from .plans import COPIES, EDGES, POINTS, SETTINGS


def test_the_same_place_and_a_copy_of_it_are_told_apart(maze, see):
    """A copy is the same plan with every length off by 2 % and some junctions changed."""
    part = list(range(60))
    quiet = {"centre_m": 0.02, "branch_rad": 0.02, "bend_m": 0.0, "missed": 0.0}
    a, again = (prepare(see(maze, part, s, f"s{s}", **quiet, branch_fault=0.0)) for s in (1, 2))
    copy = see(maze, part, 3, "copy", **quiet, branch_fault=0.0)
    rng = np.random.default_rng(4)
    stretched = copy.xy.copy()
    for axis in (0, 1):
        lines, line = np.unique(
            np.round(maze.xy[copy.info["truth"]][:, axis], 1), return_inverse=True
        )
        gaps = np.diff(lines, prepend=lines[0]) * (1 + rng.normal(0, 0.03, len(lines)))
        stretched[:, axis] = np.cumsum(gaps)[line]
    other = prepare(_redrawn(copy, stretched))
    cases = [(a, m, match(a, m, SETTINGS)[0]) for m in (again, other)]
    same, copied = sameness(cases, COPIES)
    assert same.bits > 10
    assert copied.bits < 2


def test_an_alignment_of_walls_alone_is_tested_beside_others(maze, see):
    """It has no junctions to compare: neither it nor its neighbours in the list change by that."""
    a, b = (prepare(see(maze, list(range(60)), s, f"s{s}")) for s in (1, 2))
    found = match(a, b, SETTINGS)[0]
    none = np.zeros(0, np.int64)
    bare = replace(
        found, a=none, b=none, turn=np.zeros(0, complex), support=NO_SUPPORT, conflicts=NO_CONFLICTS
    )
    cases = [(a, b, c) for c in (bare, found, bare)]
    first, alone, last = sameness(cases, COPIES)
    assert (first.bits, first.compared, first.changed) == (last.bits, last.compared, 0)
    assert first.bits == 0
    assert alone.bits == pytest.approx(next(iter(sameness(cases[1:2], COPIES))).bits)


def _redrawn(topomap, xy):
    length = np.hypot(*(xy[topomap.target] - xy[topomap.source]).T)
    paths = tuple(xy[[u, v]] for u, v in zip(topomap.source, topomap.target, strict=True))
    rows = [np.sort(r) for r in (topomap.branches[v] for v in range(len(topomap)))]
    assert all(len(r) for r in rows)
    turn = _turn(topomap)
    moved = [wrap(r - turn) for r in rows]
    order = [np.argsort(r) for r in moved]
    rank = [np.argsort(o) for o in order]

    def branch(vertex, index):
        pairs = zip(vertex, index, strict=True)
        return np.array([-1 if k < 0 else rank[v][k] for v, k in pairs], np.int64)

    return replace(
        topomap,
        xy=xy,
        length=length,
        paths=paths,
        branches=Ragged.from_rows(r[o] for r, o in zip(moved, order, strict=True)),
        source_branch=branch(topomap.source, topomap.source_branch),
        target_branch=branch(topomap.target, topomap.target_branch),
    )


def _turn(topomap):
    """How far the map's grid is turned."""
    angle = topomap.branches.values
    return float(np.angle(np.exp(4j * angle).mean()) / 4)


def test_a_building_that_repeats_itself_is_found_out(drawn):
    twice = [*POINTS, *[(x + 40.0, y + 0.03 * x) for x, y in POINTS]]
    n = len(POINTS)
    edges = [*EDGES, *[(u + n, v + n) for u, v in EDGES], (2, n)]
    wings, plain = prepare(drawn("wings", twice, edges)), prepare(drawn("plain", POINTS, EDGES))
    repeated, few = self_matches([wings, plain], SETTINGS)
    assert repeated[0].bits > 15
    assert len(repeated[0]) >= n - 2
    assert all(len(c) < 5 for c in few)
    learned = copy_model([(wings, repeated[0])], SETTINGS)
    assert np.dot(learned.exact_odds, SHARES) > np.dot(COPIES.exact_odds, SHARES)
    assert sum(learned.exact_odds) == pytest.approx(1.0)
    assert SETTINGS.copy_change_rate < learned.change_rate < 0.15  # the bent copy's branches differ
