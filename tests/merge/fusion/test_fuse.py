"""Fusion by hand-drawn maps: identities, lengths, new portions, parallels, missed junctions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.fusion.fuse import fuse
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.topology.se2 import apply, fit_rigid

MOVED = (3.0, -7.0, 2.1)

TOWN = {
    "p": (0, 0), "q": (7, 0), "r": (7, 6), "s": (0, 6), "t": (15, 0), "u": (15, 6), "v": (-8, 6),
}  # fmt: skip
WEST = ("p", "q", "r", "s", "v")
EAST = ("p", "q", "r", "s", "t", "u")
STREETS = [
    ("p", "q"), ("q", "r"), ("r", "s"), ("s", "p"), ("q", "t"), ("r", "u"), ("t", "u"), ("s", "v"),
]  # fmt: skip


def part(draw, run, names, T=(0.0, 0.0, 0.0), streets=STREETS, **options):
    """The map of the named corners of the town; streets that lead out are unexplored branches."""
    inside = [(x, y) for x, y in streets if x in names and y in names]
    out = [(x, y) for x, y in streets if (x in names) != (y in names)]
    stubs = []
    for x, y in out:
        near, far = (x, y) if x in names else (y, x)
        step = np.subtract(TOWN[far], TOWN[near])
        stubs.append((near, float(np.arctan2(step[1], step[0]))))
    return draw(run, {n: TOWN[n] for n in names}, inside, stubs, T=T, **options)


def verdict(a, b, matched, bits=20.0):
    pairs = np.array(matched)
    T = fit_rigid(a.xy[pairs[:, 0]], b.xy[pairs[:, 1]])
    best = Alignment(T, bits, pairs, 0.0)
    return PairVerdict(a.run, b.run, Verdict.MERGED, True, bits, "", best=best)


def common(names_a, names_b):
    return [(names_a.index(n), names_b.index(n)) for n in names_a if n in names_b]


def ends(fused):
    return sorted(
        tuple(sorted(p)) for p in zip(fused.source.tolist(), fused.target.tolist(), strict=True)
    )


@pytest.fixture(name="town")
def _town(draw):
    west, east = part(draw, "west", WEST), part(draw, "east", EAST, MOVED)
    return west, east, verdict(east, west, common(EAST, WEST))


def test_two_maps_become_one(town):
    west, east, match = town
    (component,), fused = fuse([west, east], [match])
    assert len(fused) == len(TOWN)
    assert len(fused.source) == len(STREETS)
    # The frame is that of the first run by name; the other is placed in it.
    assert component.poses["east"] == pytest.approx(np.zeros(3))
    assert component.poses["west"] == pytest.approx(np.array(MOVED), abs=1e-6)
    truth = apply(np.array(MOVED), np.array(list(TOWN.values()), float))
    for xy, members in zip(fused.xy, fused.members, strict=True):
        name = WEST[members["west"][0]] if "west" in members else EAST[members["east"][0]]
        assert xy == pytest.approx(truth[list(TOWN).index(name)], abs=1e-3)
    assert sorted(len(m) for m in fused.members) == [1, 1, 1, 2, 2, 2, 2]
    assert sum(len(o) for o in fused.observations) == len(west) + len(east)
    assert fused.kind.count("dead_end") == 1


def test_lengths_are_combined_by_inverse_variance_with_provenance(draw):
    west = part(draw, "west", WEST, sigma=0.1, lengths={("p", "q"): 7.2})
    east = part(draw, "east", EAST, MOVED, sigma=0.05, lengths={("p", "q"): 6.95})
    _, fused = fuse([west, east], [verdict(east, west, common(EAST, WEST))])
    (k,) = [k for k, m in enumerate(fused.edge_members) if set(m) == {("east", 0), ("west", 0)}]
    assert fused.length[k] == pytest.approx((7.2 * 100 + 6.95 * 400) / 500)
    assert fused.length_sigma[k] == pytest.approx(500**-0.5)
    assert fused.traversals[k] == 2
    alone = [m for m in fused.edge_members if len(m) == 1]
    assert len(alone) == 4


def test_a_run_that_matched_nothing_is_a_component_of_its_own_unchanged(draw, town):
    west, east, match = town
    island = part(draw, "island", ("p", "q", "r"), (500.0, 2.0, 1.0))
    refused = replace(match, accepted=False, verdict=Verdict.UNRELATED)
    components, fused = fuse([island, west, east], [match])
    assert [sorted(c.poses) for c in components] == [["east", "west"], ["island"]]
    mine = np.flatnonzero(fused.component == 1)
    assert fused.xy[mine] == pytest.approx(island.xy)
    assert [fused.branches[v].tolist() for v in mine] == [
        island.branches[v].tolist() for v in range(3)
    ]
    edges = np.flatnonzero(fused.component[fused.source] == 1)
    assert fused.length[edges] == pytest.approx(island.length)
    assert components[1].poses["island"].tolist() == [0.0, 0.0, 0.0]
    apart, fused = fuse([west, east], [refused])
    assert [len(c.poses) for c in apart] == [1, 1]
    assert len(fused) == len(west) + len(east)


def test_a_long_corridor_is_replaced_by_the_two_past_a_junction_it_did_not_see(draw):
    shape = {"p": (0, 0), "m": (6, 0), "q": (13, 0), "n": (6, 5)}
    seen = draw(
        "a", shape, [("p", "m"), ("m", "q"), ("m", "n")], [("p", np.pi / 2), ("q", np.pi / 2)]
    )
    blind = draw(
        "b",
        {k: shape[k] for k in ("p", "q")},
        [("p", "q")],
        [("p", np.pi / 2), ("q", np.pi / 2)],
        T=MOVED,
    )
    _, fused = fuse([seen, blind], [verdict(seen, blind, [(0, 0), (2, 1)])])
    assert len(fused) == 4
    assert ends(fused) == [(0, 1), (1, 2), (1, 3)]
    pairs = zip(fused.source.tolist(), fused.target.tolist(), strict=True)
    members = dict(zip(pairs, fused.edge_members, strict=True))
    assert members[0, 1] == (("a", 0), ("b", 0))
    assert members[1, 2] == (("a", 1), ("b", 0))
    assert sorted(fused.traversals.tolist()) == [1, 2, 2]


def test_a_false_match_among_right_ones_gives_way(draw):
    # One pair is wrong by a whole street; the others hold the maps where they belong.
    west, east = part(draw, "west", WEST), part(draw, "east", EAST, MOVED)
    right = common(EAST, WEST)
    match = verdict(east, west, right)
    wrong = np.array([*right, (EAST.index("u"), WEST.index("v"))])
    (component,), _ = fuse([west, east], [replace(match, best=replace(match.best, matched=wrong))])
    off = np.abs(component.poses["west"] - np.array(MOVED))
    assert off[:2].max() < 1.0
    assert off[2] < 0.1
