"""What to record next: hand-drawn sites of one corridor, and what may stand in their way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.drives import DRIVES, drives, never_driven
from topobatch.merge.result import (
    Alignment,
    Component,
    CopyTest,
    FusedMap,
    MergeResult,
    PairVerdict,
    Verdict,
)
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, inverse

STEP = 10.0
T_A_B = np.array([70.0, 5.0, 0.5])
"""Where b's map lies in a's frame."""


def line(first: int, count: int, T: np.ndarray, turn: float = 0.0):
    """Junctions first, first + 1, … of a straight corridor, in the frame that lies at T, each with
    a branch ahead, one back, and one to the left that nobody drove."""
    xy = np.column_stack([STEP * np.arange(first, first + count), np.zeros(count)])
    headings = np.array([0.0, np.pi / 2, -np.pi]) - T[2]
    return apply(inverse(T), xy), np.sort((headings + np.pi) % (2 * np.pi) - np.pi)


def merge_of(sites, verdicts, bits=12.0):
    """sites: {run: (first, count, T)}, each run a site of its own."""
    xy, branches, component, members, source, target, branch = [], [], [], [], [], [], []
    for c, (run, (first, count, T)) in enumerate(sites.items()):
        own, headings = line(first, count, T)
        begin = len(component)
        xy.append(own)
        branches += [headings] * count
        component += [c] * count
        members += [{run: (k,)} for k in range(count)]
        source += range(begin, begin + count - 1)
        target += range(begin + 1, begin + count)
        ahead = np.abs(np.exp(1j * headings) - np.exp(-1j * T[2])).argmin()
        back = np.abs(np.exp(1j * headings) + np.exp(-1j * T[2])).argmin()
        branch += [(ahead, back)] * (count - 1)
    xy = np.concatenate(xy)
    m = len(source)
    fused = FusedMap(
        xy=xy,
        branches=Ragged.from_rows(branches),
        kind=("junction",) * len(xy),
        source=np.array(source, np.int64),
        target=np.array(target, np.int64),
        source_branch=np.array([b for b, _ in branch], np.int64),
        target_branch=np.array([b for _, b in branch], np.int64),
        length=np.full(m, STEP),
        length_sigma=np.full(m, 0.1),
        traversals=np.ones(m, np.int64),
        paths=tuple(np.array([xy[u], xy[v]]) for u, v in zip(source, target, strict=True)),
        component=np.array(component),
        members=tuple(members),
        observations=((),) * len(xy),
        edge_members=((),) * m,
    )
    components = tuple(Component(c, {run: np.zeros(3)}, site=run) for c, run in enumerate(sites))
    return MergeResult(components, fused, tuple(verdicts))


def open_pair(matched, T=T_A_B, *, bits=9.0, a="a", b="b", other=None, **more):
    best = Alignment(T, bits, np.array(matched), 0.1)
    return PairVerdict(
        a, b, Verdict.AMBIGUOUS, False, bits, "too little", best, other,
        threshold_bits=12.5, **more,
    )  # fmt: skip


A, B = (0, 12, np.zeros(3)), (8, 12, T_A_B)
COMMON = [(8, 0), (9, 1), (10, 2), (11, 3)]


def test_one_drive_passes_enough_of_both() -> None:
    first, *rest = drives(merge_of({"a": A, "b": B}, [open_pair(COMMON)]))
    # 9 bits of 4 junctions are 2.25 for each; 12.5 bits are needed.
    need = 6 + DRIVES.spare_junctions
    assert (first.site, first.onto, first.pairs) == ("a", "b", (("a", "b"),))
    here = [s.junction for s in first.stops if s.site == "a"]
    there = [s.junction for s in first.stops if s.site == "b"]
    assert here == list(range(12 - need, 12))
    assert there == list(range(12 + 4, 12 + 4 + need - 4))
    assert first.length_m == pytest.approx(STEP * (2 * need - 4 - 1))
    assert first.known_m == pytest.approx(STEP * (need - 1))
    # The other's part lies where the placement has it: straight on.
    assert first.path[-1] == pytest.approx([STEP * (12 + need - 4 - 1), 0.0], abs=1e-6)
    assert first.bits == pytest.approx(2.25 * need * 2**9 / (2**9 + 1))
    assert [d.onto for d in rest] == [None, None]
    assert first.bits_per_m > rest[0].bits_per_m
    where, settles = first.words
    assert where == f"{first.length_m:.0f} m in a, from junction 3 towards 4"
    assert settles == "joins a and b, if they are one place: settles 1 open pair"
    assert first.way.endswith("11; in b: 16, 17, 18, 19, 20")


def test_into_the_unknown_from_what_is_known() -> None:
    # Two sites of which a drive may show that they are one; with more, and none open, it will not.
    found = drives(merge_of({"a": A, "b": B}, []))
    need = 5 + DRIVES.spare_junctions
    assert {(d.site, d.onto, d.pairs) for d in found} == {("a", None, ()), ("b", None, ())}
    first = next(d for d in found if d.site == "a")
    assert len(first.stops) == need + 1
    assert first.stops[-1].junction is None
    assert first.heading_rad is not None
    assert abs(np.exp(1j * first.heading_rad) - 1j) < 1.5  # no way back along the corridor
    assert "by the branch never driven" in first.way
    assert first.length_m == pytest.approx(first.known_m + DRIVES.beyond * need * STEP)
    # It is on corridors all the way to the branch, and leaves the map by one of usual length.
    known = [s.xy for s in first.stops[:-1]]
    assert np.array(known)[:, 1] == pytest.approx(0.0)
    assert np.hypot(*np.subtract(first.stops[-1].xy, known[-1])) == pytest.approx(STEP, abs=0.01)
    assert first.path[-1] == pytest.approx(first.stops[-1].xy, abs=0.01)
    assert f"past about {2 * need} junctions ({2 * need * STEP:.0f} m)" in first.way


@pytest.mark.parametrize(("bits", "proposed"), [(3.0, True), (0.5, False)])
def test_where_it_would_tell_no_copy_nothing_is_proposed(bits: float, proposed: bool) -> None:
    # Of four junctions each has a quarter of this; 8 bits are needed, by at most 21 junctions.
    pair = open_pair(COMMON)
    test = CopyTest(bits, 8.0, 1.0)
    pair = replace(pair, best=replace(pair.best, copy_test=test))
    assert bool(drives(merge_of({"a": A, "b": B}, [pair]))) == proposed


def test_sites_that_a_person_locked_apart_are_not_joined() -> None:
    sites = {"a": A, "b": B}
    assert drives(merge_of(sites, [open_pair(COMMON)]))[0].onto == "b"
    locked = PairVerdict("a", "b", Verdict.UNRELATED, False, 0.0, "", locked="never")
    assert all(d.onto is None for d in drives(merge_of(sites, [open_pair(COMMON), locked])))


def test_what_hardly_brings_evidence_is_not_proposed() -> None:
    many = {f"r{k:02}": (0, 12, np.zeros(3)) for k in range(9)}
    result = merge_of(many, [])
    assert drives(result) == ()
    assert drives(merge_of({"a": A}, [])) == ()  # there is nothing to join
    left = never_driven(result)
    assert {b.site for b in left} == many.keys()
    assert {b.junction for b in left if b.site == "r01"} == {*range(12, 24)}


def test_nothing_to_drive() -> None:
    result = merge_of({"a": A}, [])
    branch = [np.array([0.0])] + [np.array([-np.pi, 0.0])] * 10 + [np.array([-np.pi])]
    back = np.array([1] * 10 + [0])
    ahead = np.array([0] + [1] * 10)
    driven = replace(
        result.fused, branches=Ragged.from_rows(branch), source_branch=ahead, target_branch=back * 0
    )
    assert drives(replace(result, fused=driven)) == ()
    assert drives(MergeResult((), merge_of({"a": (0, 1, np.zeros(3))}, []).fused, ())) == ()
