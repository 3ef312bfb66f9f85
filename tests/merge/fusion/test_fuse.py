"""Fusion by hand-drawn maps: identities, lengths, new portions, parallels, missed junctions."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from topobatch.merge.fusion.fuse import fuse
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.topology.polyline import way_of
from topobatch.topology.posegraph.graph import Priors
from topobatch.topology.ragged import Ragged
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
HEADINGS = {"e": 0.0, "w": np.pi, "n": np.pi / 2, "s": -np.pi / 2}


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


def test_what_runs_see_alike_is_no_surer_for_being_seen_twice(draw):
    def sigmas(shared_m, asked=(), length_sigma=0.05):
        maps = [part(draw, run, WEST, sigma=length_sigma) for run in ("one", "two")]
        maps = [replace(m, noise=replace(m.noise, shared_centre_m=shared_m)) for m in maps]
        _, fused = fuse(maps, [verdict(*maps, common(WEST, WEST))], asked=asked)
        return maps[0].length_sigma.min(), fused.length_sigma.min(), fused.position_sigma

    own, mean, _ = sigmas(0.0, None)
    assert mean == pytest.approx(own / np.sqrt(2))
    assert sigmas(10.0, None)[1] == pytest.approx(own)
    assert sigmas(0.5)[2].max() > sigmas(0.0)[2].max()
    assert sigmas(0.5, length_sigma=1.0)[1] == pytest.approx(np.sqrt(2) * 0.5, rel=0.4)


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


def test_lengths_reach_from_fused_vertex_to_fused_vertex(draw):
    """All runs tell where a corridor ends, also those that did not drive it."""
    west, east = part(draw, "west", WEST), part(draw, "east", EAST, MOVED)
    off = west.xy.copy()
    off[1] += (-0.3, 0.0)
    seen = replace(
        west,
        xy=off,
        length=west.length - [0.3, 0.0, 0.0, 0.0, 0.0],
        paths=(off[[0, 1]], off[[1, 2]], *west.paths[2:]),
    )
    _, fused = fuse([seen, east], [verdict(east, seen, common(EAST, WEST))])
    (alone,) = [k for k, m in enumerate(fused.edge_members) if m == (("east", 4),)]
    assert 8.05 < fused.length[alone] < 8.3  # from q, which west saw farther away, to t
    drawn = [float(way_of(path)[-1]) for path in fused.paths]
    assert fused.length == pytest.approx(drawn, abs=0.01)


def test_branches_are_averaged_on_the_circle_and_unexplored_ones_kept(town):
    west, east, match = town
    rows = [east.branches[v] + (0.06 if v == 0 else 0.0) for v in range(len(east))]
    bent = replace(east, branches=Ragged.from_rows(rows))
    _, fused = fuse([west, bent], [match])
    at_p = next(k for k, m in enumerate(fused.members) if m == {"east": (0,), "west": (0,)})
    straight = np.sort((west.branches[0] + MOVED[2] + np.pi) % (2 * np.pi) - np.pi)
    # The turn of a vertex is seen by its corridors too, so the mean lies in between.
    assert fused.branches[at_p] == pytest.approx(straight + 0.03, abs=0.02)
    degree = {
        WEST[m["west"][0]]: len(fused.branches[k])
        for k, m in enumerate(fused.members)
        if "west" in m
    }
    assert degree == {"p": 2, "q": 3, "r": 3, "s": 3, "v": 1}


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


def test_no_maps_and_empty_maps(draw):
    assert fuse([], [])[0] == ()
    empty = draw("empty", {}, [])
    components, fused = fuse([empty], [])
    assert len(fused) == 0
    assert len(components) == 1


def test_a_vertex_that_no_pair_matched_is_fused_where_it_coincides(town):
    west, east, match = town
    few = replace(match.best, matched=match.best.matched[:3])
    _, fused = fuse([west, east], [replace(match, best=few)])
    assert len(fused) == len(TOWN)


@pytest.mark.parametrize("shared", [2, 3])
def test_runs_that_only_a_third_places_are_fused_where_several_places_coincide(draw, shared):
    """a drove along, b across the same junctions: no corridor is common to both."""
    crossings = {f"x{k}": (9.0 * k, 20.0) for k in range(shared)}
    left = {"p": (-9, 0), "q": (-9, 8), "r": (-16, 8)}
    right = {f"y{k}": (9.0 * k, 31.0 + k) for k in range(shared)}
    four = [(x, heading) for x in crossings for heading in HEADINGS.values()]

    def cross(inside):
        """Branches of the crossings that none of these corridors takes."""
        at = {**crossings, **left, **right}
        used = {
            (x, round(float(np.arctan2(*np.subtract(at[y], at[x])[::-1])), 6))
            for u, v in inside
            for x, y in ((u, v), (v, u))
        }
        return [(x, h) for x, h in four if (x, round(float(h), 6)) not in used]

    along = [("p", "x0"), *pairwise(crossings), ("p", "q"), ("q", "r")]
    over = [*zip(crossings, right, strict=True), *pairwise(right)]
    a = draw("a", {**crossings, **left}, along, cross(along))
    b = draw("b", {**crossings, **right}, over, cross(over), T=MOVED)
    c = draw("c", {**left, **right}, [("p", "q"), ("q", "r"), ("r", "y0"), *pairwise(right)])
    first = [(shared + k, k) for k in range(3)]
    second = [(shared + k, 3 + k) for k in range(shared)]
    _, fused = fuse([a, b, c], [verdict(a, c, first), verdict(b, c, second)])
    common = [m for m in fused.members if "a" in m and "b" in m]
    assert len(common) == (shared if shared > 2 else 0)


def test_matches_are_transitive_but_never_put_two_vertices_of_a_run_together(draw):
    a, b, c = (
        part(draw, run, ("p", "q", "r", "s"), T)
        for run, T in zip("abc", [(0, 0, 0.0), MOVED, (9, 9, -1.0)], strict=True)
    )
    ab, bc = verdict(a, b, [(k, k) for k in range(4)]), verdict(b, c, [(k, k) for k in range(4)])
    wrong = verdict(a, c, [(0, 0), (1, 1), (2, 2), (3, 3)], bits=1.0)
    wrong = replace(wrong, best=replace(wrong.best, matched=np.array([[0, 1], [1, 2]])))
    _, fused = fuse([a, b, c], [ab, bc, wrong])
    assert list(fused.members) == [{"a": (k,), "b": (k,), "c": (k,)} for k in range(4)]


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


def test_a_part_that_nobody_drove_alone_becomes_a_corridor(draw):
    shape = {"p": (0, 0), "m": (6, 0), "q": (13, 0), "n": (6, 5)}
    up = np.pi / 2
    seen = draw(
        "a", {k: shape[k] for k in "pmn"}, [("p", "m"), ("m", "n")], [("p", up), ("m", 0.0)]
    )
    blind = draw("b", {k: shape[k] for k in "pq"}, [("p", "q")], [("p", up), ("q", up)])
    (_, fused) = fuse([seen, blind], [verdict(seen, blind, [(0, 0)])])
    assert len(fused) == 4
    assert len(fused.source) == 3
    new = next(k for k, m in enumerate(fused.edge_members) if m == (("b", 0),))
    assert fused.length[new] == pytest.approx(7.0, abs=0.3)


def with_edge(m, ends, length, path):
    """The map with one more corridor, ends (vertex, branch, vertex, branch)."""
    u, i, v, j = ends

    def add(name, value):
        return np.append(getattr(m, name), value)

    return replace(
        m,
        source=add("source", u),
        target=add("target", v),
        source_branch=add("source_branch", i),
        target_branch=add("target_branch", j),
        length=add("length", length),
        length_sigma=add("length_sigma", 0.1),
        traversals=add("traversals", 1),
        paths=(*m.paths, np.array(path, float)),
    )


def test_parallel_corridors_and_loops_stay_apart(draw):
    up, back = np.pi / 2, np.pi
    base = [
        draw(
            run,
            {"p": (0, 0), "q": (8, 0)},
            [("p", "q")],
            [("p", up), ("q", up), ("p", back), ("p", -up)],
        )
        for run in "ab"
    ]
    arch = [(0, 0), (0, 4), (8, 4), (8, 0)]
    ring = [(0, 0), (-5, 0), (-5, -5), (0, -5), (0, 0)]
    maps = []
    for m in base:
        at = {h: int(np.abs(m.branches[0] - h).argmin()) for h in (up, -up)}
        west = int(np.abs(np.abs(m.branches[0]) - np.pi).argmin())
        arched = with_edge(m, (0, at[up], 1, int(np.abs(m.branches[1] - up).argmin())), 16.0, arch)
        maps.append(with_edge(arched, (0, west, 0, at[-up]), 20.0, ring))
    _, fused = fuse(maps, [verdict(maps[0], maps[1], [(0, 0), (1, 1)])])
    assert sorted(fused.length.round(6).tolist()) == [8.0, 16.0, 20.0]
    assert ends(fused) == [(0, 0), (0, 1), (0, 1)]
    assert all(len(m) == 2 for m in fused.edge_members)
    # The same branches but quite another length: kept apart, not averaged.
    other = replace(maps[1], length=maps[1].length * [1, 1.5, 1])
    _, fused = fuse([maps[0], other], [verdict(maps[0], other, [(0, 0), (1, 1)])])
    assert sorted(fused.length.round(6).tolist()) == [8.0, 16.0, 20.0, 24.0]


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


def far_end_of_a_chain(draw, *, placed_deg=0.0, read_deg=0.0):
    """Four maps in a row, 20 m each, that share one junction with the next: where the last ends.

    placed_deg: how far each verdict turns its second map; read_deg: how far off each map read the
    branches of its first junction.
    """
    chain = []
    for k in range(4):
        corners = {0: (20.0 * k, 0.0), 1: (20.0 * k + 20, 0.0), 2: (20.0 * k, 8.0)}
        stubs = [(0, np.pi), (1, 0.0), (1, np.pi / 2), (2, np.pi / 2)]
        m = draw(f"r{k}", corners, [(0, 1), (0, 2)], stubs)
        rows = [m.branches[v] + np.deg2rad(read_deg) * (v == 0) for v in range(len(m))]
        chain.append(replace(m, branches=Ragged.from_rows(rows)))
    links = []
    for a, b in pairwise(chain):
        bent = np.array([0.0, 0.0, np.deg2rad(placed_deg)])
        bent[:2] = a.xy[1] - apply(bent, b.xy[0])
        best = Alignment(bent, 20.0, np.array([[1, 0]]), 0.0)
        links.append(PairVerdict(a.run, b.run, Verdict.MERGED, True, 20.0, "", best=best))
    _, fused = fuse(chain, links)
    return fused.xy[next(k for k, m in enumerate(fused.members) if m == {"r3": (1,)})]


def test_how_maps_are_turned_against_each_other_is_told_by_branches_and_not_by_verdicts(draw):
    assert far_end_of_a_chain(draw, placed_deg=6.0) == pytest.approx([80.0, 0.0], abs=0.3)


def test_a_grid_keeps_a_chain_of_rectilinear_maps_from_bending(draw, monkeypatch):
    assert far_end_of_a_chain(draw, read_deg=-4.0) == pytest.approx([80.0, 0.0], abs=1.0)
    without = lambda pool, guess: Priors.empty()  # noqa: E731
    monkeypatch.setattr("topobatch.merge.fusion.joint_graph._grid_priors", without)
    assert far_end_of_a_chain(draw, read_deg=-4.0)[1] > 8.0


@pytest.mark.parametrize(("lengths", "together"), [((6.0, 6.0), True), ((9.0, 9.0), False)])
def test_corridors_of_other_lengths_keep_vertices_apart_that_lie_on_each_other(
    draw, lengths, together
):
    """Both runs drove two corridors from s; in b they are as long, or longer."""
    cross = {"s": (0, 0), "e": (6, 0), "n": (0, 6)}
    down = {"h": (-6, 0), "k": (-6, -7), "l": (-12, -7)}
    drives = [("h", "k"), ("k", "l"), ("s", "e"), ("s", "n")]
    a = draw("a", {**down, **cross}, [*drives, ("h", "s")])
    longer = dict(zip([("s", "e"), ("s", "n")], lengths, strict=True))
    b = draw("b", {**down, **cross}, drives, [("s", np.pi), ("h", 0.0)], lengths=longer)
    _, fused = fuse([a, b], [verdict(a, b, [(0, 0), (1, 1), (2, 2)])])
    assert ({"a": (3,), "b": (3,)} in [dict(m) for m in fused.members]) is together
