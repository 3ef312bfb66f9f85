"""Groups of runs whose pairs only together are told from copies."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from topobatch.merge.robust import RobustSettings, match, prepare
from topobatch.merge.robust.components import Components
from topobatch.merge.robust.rematching import Rematcher, _least_cuts, _two_parts
from topobatch.merge.robust.repetition import default_copies
from topobatch.merge.robust.verdict import Bar, opinion

SETTINGS = RobustSettings()
EXACT = {"centre_m": 0.02, "branch_rad": 0.02, "bend_m": 0.0, "missed": 0.0, "branch_fault": -1.0}


def rematched(maps, need_copy_bits):
    """The components and reunions of maps in a building that repeats itself throughout."""
    ready = [prepare(m) for m in maps]
    level = Bar(15.0, need_copy_bits, 1.0, 0, default_copies(SETTINGS), SETTINGS)
    pairs = list(combinations(range(len(maps)), 2))
    views = {
        (i, j): opinion(ready[i], ready[j], match(ready[i], ready[j], SETTINGS), level)
        for i, j in pairs
    }
    parts = Components(len(maps), ())
    return views, parts, Rematcher(maps, ready, parts, views, lambda _: level, SETTINGS).run({})


@pytest.fixture(scope="module")
def three(maze, see):
    """Three sectors of a maze; each two of them share another part of it."""
    x, y = (maze.xy - maze.xy.mean(axis=0)).T
    angle = np.degrees(np.arctan2(y, x)) % 360
    return [
        see(maze, np.flatnonzero((angle - first) % 360 < 190).tolist(), k, name, **EXACT)
        for k, (name, first) in enumerate((("a", 0), ("b", 120), ("c", 240)))
    ]


def test_runs_that_only_together_are_no_copies_become_one(three):
    views, _, _ = rematched(three, 1e6)
    same = sorted(view.same_bits for view in views.values())
    views, parts, found = rematched(three, same[-1] + 0.5)
    assert all(view.maybe_copy for view in views.values())
    assert parts.together(0, 1)
    assert parts.together(0, 2)
    assert set(found) == set(views)
    for (i, j), reunion in found.items():
        assert reunion.alignment.evidence_bits >= 15.0
        assert sorted(sum(reunion.sides, ())) == ["a", "b", "c"]
        assert any((three[i].run in side) != (three[j].run in side) for side in reunion.sides)
        assert "together with" in reunion.reason


def test_a_group_whose_weakest_cut_fails_is_none(three):
    views, _, _ = rematched(three, 1e6)
    need = 3 * max(view.same_bits for view in views.values())
    _, parts, found = rematched(three, need)
    assert found == {}
    assert len(parts.members) == 3


def test_runs_kept_apart_stay_apart_in_groups(three):
    views, _, _ = rematched(three, 1e6)
    level = Bar(15.0, 1e6, 1.0, 0, default_copies(SETTINGS), SETTINGS)
    parts = Components(3, [(0, 2)])
    ready = [prepare(m) for m in three]
    Rematcher(three, ready, parts, views, lambda _: level, SETTINGS).run({})
    assert not parts.together(0, 2)


def test_groups_are_cut_in_every_way_that_leaves_both_sides_tied():
    chain = [(0,), (1, 2), (3,)]
    cuts = _two_parts(chain, {(0, 1): 5.0, (2, 3): 2.0})
    assert cuts == [([(0,), (1, 2)], [(3,)]), ([(0,)], [(1, 2), (3,)])]
    ring = [(k,) for k in range(4)]
    cuts = _two_parts(ring, {(0, 1): 1.0, (1, 2): 1.0, (2, 3): 1.0, (0, 3): 1.0})
    assert len(cuts) == 6  # four single ones, two halves; no opposite corners


def test_two_clusters_of_many_runs_are_cut_between_them():
    one, two = range(4), range(4, 8)
    bits = {pair: 9.0 for side in (one, two) for pair in combinations(side, 2)} | {(3, 4): 1.0}
    assert frozenset(one) in _least_cuts(8, bits)
    first, *others = _two_parts([(k,) for k in range(8)], bits)
    assert first == ([(0,), (1,), (2,), (3,)], [(4,), (5,), (6,), (7,)])
    assert len(others) >= 6


def test_of_many_runs_only_those_tied_strongly_are_tried(monkeypatch, three):
    views, _, _ = rematched(three, 1e6)
    level = Bar(15.0, 1e6, 1.0, 0, default_copies(SETTINGS), SETTINGS)
    ready = [prepare(m) for m in three]
    rematcher = Rematcher(three, ready, Components(3, ()), views, lambda _: level, SETTINGS)
    parts, links = [(0,), (1,), (2,)], dict.fromkeys(views)
    assert rematcher._strongly_tied(parts, links) == [parts]
    monkeypatch.setattr("topobatch.merge.robust.rematching.MOST_TRIED", 2)
    assert rematcher._strongly_tied(parts, links) == []  # all are tied too weakly for 1e6 bits
    rematcher.opinions = {p: rematched(three, 0.1)[0][p] for p in views}
    assert rematcher._strongly_tied(parts, links) == []  # three are too many
    assert rematcher._strongly_tied([*parts, (3,)], {(0, 1): None}) == [[(0,), (1,)]]
