"""Verdicts on maps of simulated worlds, whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.locks import Lock
from topobatch.merge.result import Verdict
from topobatch.merge.robust import RobustSettings, decide
from topobatch.merge.robust.mirror import mirrored
from topobatch.simulation.worlds import make_world
from topobatch.topology.errors import UsageError
from topobatch.topology.se2 import apply


def only(maps, **options):
    (verdict,) = decide(sorted(maps, key=lambda m: m.run), **options)
    return verdict


def test_overlapping_maps_are_merged_where_they_belong(halves, right_matches):
    a, b = halves
    v = only(halves)
    assert v.verdict is Verdict.MERGED
    assert v.accepted
    common = set(a.info["truth"]) & set(b.info["truth"])
    assert len(v.best.matched) >= 0.8 * len(common)
    assert right_matches(v.best.matched, a, b) == 1.0
    off = apply(v.best.transform, b.xy[v.best.matched[:, 1]]) - a.xy[v.best.matched[:, 0]]
    assert np.median(np.hypot(*off.T)) < 0.5
    assert v.evidence_bits > 30
    assert v.reason.startswith(f"{len(v.best.matched)} junctions and {v.best.corridors} corridors")


def test_maps_of_different_buildings_stay_apart(halves, other_maze, see):
    stranger = see(other_maze, list(range(60)), 5, "stranger")
    verdicts = decide(sorted([*halves, stranger], key=lambda m: m.run))
    joined = {(v.a, v.b) for v in verdicts if v.accepted}
    assert joined == {("left", "right")}
    assert all(v.verdict is Verdict.UNRELATED for v in verdicts if "stranger" in (v.a, v.b))
    assert all(v.reason for v in verdicts)


@pytest.mark.parametrize("kind", ["maze", "organic"])
def test_faults_and_drift_do_not_mislead(kind, see, right_matches):
    world, across = (w := make_world(kind, 100, 40)), w.xy[:, 0]
    faults = {"missed": 0.04, "branch_fault": 0.08, "bend_m": 0.5, "centre_m": 0.08}
    a = see(world, np.flatnonzero(across < np.quantile(across, 0.7)).tolist(), 0, "a", **faults)
    b = see(world, np.flatnonzero(across > np.quantile(across, 0.3)).tolist(), 9, "b", **faults)
    v = only([a, b])
    assert v.accepted
    assert right_matches(v.best.matched, a, b) > 0.97


def test_never_holds_through_other_runs(maze, see):
    across = maze.xy[:, 0]
    edges = np.quantile(across, [0.0, 0.45, 0.25, 0.75, 0.55, 1.0])
    parts = [
        np.flatnonzero((across >= low) & (across <= high)).tolist()
        for low, high in edges.reshape(3, 2)
    ]
    maps = [
        see(maze, part, k, name) for k, (part, name) in enumerate(zip(parts, "abc", strict=True))
    ]
    free = {(v.a, v.b): v for v in decide(maps)}
    assert free["a", "b"].accepted
    assert free["b", "c"].accepted
    held = {(v.a, v.b): v for v in decide(maps, locks=[Lock("a", "c", "never")])}
    assert [held["a", "b"].accepted, held["b", "c"].accepted].count(True) == 1
    refused = held["a", "b"] if held["b", "c"].accepted else held["b", "c"]
    assert refused.verdict is Verdict.AMBIGUOUS
    assert "locked apart" in refused.reason
    assert refused.advice == "if a and c share places after all, clear their lock"


def test_same_joins_what_the_evidence_would_not(side_by_side):
    a, b, at = side_by_side
    v = only([a, b], locks=[Lock("a", "b", "same", at)])
    assert v.accepted
    assert v.verdict is Verdict.MERGED
    assert v.locked == "same"
    assert list(at) in v.best.matched.tolist()
    assert "locked as the same" in v.reason


def test_a_lock_that_no_alignment_honours_is_said_to_be_so(halves, drawn):
    assert only(halves).accepted
    crossing = next(v for v in range(len(halves[0])) if halves[0].degree[v] == 4)
    end = next(v for v in range(len(halves[1])) if halves[1].degree[v] == 1)
    third = replace(halves[1], run="third")
    maps = [*halves, third]
    told = {
        (v.a, v.b): v for v in decide(maps, locks=[Lock("left", "right", "same", (crossing, end))])
    }
    wrong = told["left", "right"]
    assert (wrong.verdict, wrong.accepted) == (Verdict.AMBIGUOUS, False)
    assert "no alignment of the two honours the lock; other runs place them in" in wrong.reason
    assert told["left", "third"].accepted
    alone = only(halves, locks=[Lock("left", "right", "same", (crossing, end))])
    assert (alone.verdict, alone.accepted) == (Verdict.AMBIGUOUS, False)
    assert "one component" not in alone.reason
    assert alone.advice.startswith("clear the lock of left and right")
    pair = drawn("zwei", [(0, 0), (5, 0)], [(0, 1)])
    nothing = only([halves[0], pair], locks=[Lock("left", "zwei", "same")])
    assert "name a junction of each run that is one place" in nothing.reason


def test_locks_that_cannot_be(halves):
    with pytest.raises(UsageError, match="names junction 999"):
        only(halves, locks=[Lock("left", "right", "same", (999, 0))])
    with pytest.raises(UsageError, match="two ways"):
        only(halves, locks=[Lock("left", "right", "same"), Lock("left", "right", "never")])
    assert only(halves, locks=[Lock("left", "elsewhere", "never")]).accepted


def test_wings_built_alike_are_not_taken_for_each_other(see):
    """One run in each of two wings of one plan: beyond chance, but perhaps another copy."""
    world = make_world("office", 200, 8)
    verdicts = []
    for seed in range(3):
        regions = _apart(world, 34, seed)
        maps = [see(world, r, seed + k, "ab"[k]) for k, r in enumerate(regions)]
        verdicts.append(only(maps))
    assert not any(v.accepted for v in verdicts)
    doubtful = [v for v in verdicts if v.verdict is Verdict.AMBIGUOUS]
    assert doubtful
    assert all(v.best is not None and v.advice for v in doubtful)
    assert any("another copy" in v.reason or "another placement" in v.reason for v in doubtful)


def test_a_few_junctions_with_much_evidence_are_doubtful_not_unrelated(drawn):
    """Three junctions of an odd shape are no ground for merging, but not nothing either."""
    turns = np.cumsum([0.0, 0.5, 1.9, 0.7, 2.3, 1.1, 2.9, 0.3, 1.4])
    steps = np.array([4.0, 9.3, 6.1, 13.7, 5.2, 17.9, 7.7, 11.3, 3.1])
    track = np.cumsum(steps * np.exp(1j * turns))
    points = np.column_stack([track.real, track.imag])
    chain = [(k, k + 1) for k in range(len(points) - 1)]
    spurs = [(k, 0.37 * k * k) for k in range(len(points))]
    whole = drawn("whole", points, chain, stubs=spurs)
    few = RobustSettings(min_matches=len(points) + 1)
    v = only([whole, replace(whole, run="zwin")], settings=few)
    assert v.verdict is Verdict.AMBIGUOUS
    assert not v.accepted
    assert f"{few.min_matches} junctions at least" in v.reason
    with_three = drawn("three", points[:3], chain[:2], stubs=spurs[:3])
    v = only([whole, with_three], settings=RobustSettings(false_merge_rate=0.3))
    assert len(v.best.matched) == 3
    assert v.verdict is Verdict.AMBIGUOUS


def test_a_wing_built_the_other_way_round_is_not_the_place(drawn):
    """A straight corridor without sides fits its mirror image; all that hangs on it does not."""
    wing = _wing(drawn, "a")
    image = replace(mirrored(wing), run="b")
    v = only([wing, image])
    assert v.verdict is Verdict.AMBIGUOUS
    assert "mirror image" in v.reason
    assert only([wing, replace(mirrored(image), run="b")]).accepted


def _wing(drawn, name, first=0, last=9):
    """Part of a corridor with crossings, rooms on one of its sides."""
    steps = np.cumsum([0.0, 4.0, 9.3, 6.1, 13.7, 5.2, 17.9, 7.7, 11.3, 3.1])
    line = {k: (steps[k], 0.0) for k in range(first, last + 1)}
    side = {k: (steps[k], 6.0 + 0.7 * (k - 2)) for k in line if 2 <= k <= 7}
    chain = [(k, k + 1) for k in range(len(line) - 1)]
    hangs = [(k - first, len(line) + n) for n, k in enumerate(side)]
    crossed = [(k - first, -np.pi / 2) for k in side]
    return drawn(name, [*line.values(), *side.values()], [*chain, *hangs], stubs=crossed)


def _apart(world, size, seed):
    """Two regions of a world without a common vertex: around far vertices."""
    rng = np.random.default_rng(seed)
    centre = int(rng.integers(len(world)))
    away = np.hypot(*(world.xy - world.xy[centre]).T)
    other = int(away.argmax())
    back = np.hypot(*(world.xy - world.xy[other]).T)
    first = np.argsort(away, kind="stable")[:size].tolist()
    second = np.argsort(back, kind="stable")[:size].tolist()
    assert not set(first) & set(second)
    return first, second


def test_components_say_together_what_no_pair_can(maze, see):
    """A run that shares too little with each of two others, but enough with both."""
    across = maze.xy[:, 0]
    order = np.argsort(across, kind="stable")
    a = see(maze, order[:52].tolist(), 1, "a", missed=0.0)
    b = see(maze, order[42:].tolist(), 2, "b", missed=0.0)
    c = see(maze, order[30:66].tolist(), 3, "c", missed=0.0)
    most = max(only([a, c]).evidence_bits, only([b, c]).evidence_bits)
    strict = RobustSettings(false_merge_rate=3 * 2.0 ** -(most + 3))
    known = [Lock("a", "b", "same")]
    verdicts = {(v.a, v.b): v for v in decide([a, b, c], strict, locks=known)}
    assert verdicts["a", "c"].accepted
    assert verdicts["b", "c"].accepted
    assert "together with b" in verdicts["a", "c"].reason
    assert verdicts["a", "c"].evidence_bits > most + 3
    (u, _), (_, v) = verdicts["a", "c"].best.matched[:2].tolist()
    locks = [*known, Lock("a", "c", "same", (u, v))]
    locked = {(x.a, x.b): x for x in decide([a, b, c], strict, locks=locks)}
    assert not locked["a", "c"].accepted
    assert "no alignment of the two honours the lock" in locked["a", "c"].reason
    assert not locked["b", "c"].accepted
