"""The vectorised growth against plain recursion as the paper words it, and its special cases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from topobatch.topology.columns import take
from topobatch.topology.errors import UsageError
from topobatch.topology.matching.association import (
    Growth,
    grow,
    single_matches,
)
from topobatch.topology.matching.correspondence import (
    GrowthSettings,
    partners,
)
from topobatch.topology.matching.structure import Structure, prepare
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import wrap
from topobatch.topology.topomap import TopoMap

QUARTER = np.pi / 2

Pair = tuple[int, int]
Correspondence = tuple[Pair, ...]
"""(branch of a, branch of b), sorted."""
Node = tuple[int, int, Correspondence]


def topomap(branches, edges, sigma=0.1, run="run"):
    """A map from rows of headings and edges (u, branch of u, v, branch of v, length)."""
    n = len(branches)
    xy = np.column_stack([np.arange(n) * 5.0, np.zeros(n)])
    u, i, v, j, length = (np.array(c) for c in zip(*edges, strict=True)) if edges else ([],) * 5
    return TopoMap(
        run=run,
        frame="odom",
        xy=xy,
        branches=Ragged.from_rows(branches),
        kind=("junction",) * n,
        source=np.array(u, np.int64),
        target=np.array(v, np.int64),
        source_branch=np.array(i, np.int64),
        target_branch=np.array(j, np.int64),
        length=np.array(length, np.float64),
        length_sigma=np.broadcast_to(np.array(sigma, np.float64), (len(u),)).copy(),
        traversals=np.ones(len(u), np.int64),
        paths=tuple(np.array([xy[s], xy[t] + [0.0, 1.0]]) for s, t in zip(u, v, strict=True)),
        observation_vertex=np.arange(n),
        observation_time_ns=np.arange(n),
    )


# --- the oracle: §2.1 to §2.3, literally ----------------------------------------------------------


class Oracle:
    """Recursive growth over plain lists; shares no code with the engine."""

    def __init__(self, a: TopoMap, b: TopoMap, settings: GrowthSettings, rectilinear: bool):
        self.a, self.b, self.settings, self.rectilinear = a, b, settings, rectilinear
        self.edges_a, self.edges_b = self._incident(a), self._incident(b)
        self.grid = [self._grid(m) for m in (a, b)]
        self.slots = [self._slots(k) for k in (0, 1)]

    @staticmethod
    def _grid(m):
        z = np.exp(4j * m.branches.values)
        return np.angle(z.mean()) / 4 % QUARTER if len(z) else 0.0

    @staticmethod
    def _incident(m):
        out = {}
        for e in range(len(m.source)):
            s, t = int(m.source[e]), int(m.target[e])
            i, j = int(m.source_branch[e]), int(m.target_branch[e])
            out.setdefault((s, i), []).append((e, t, j))
            out.setdefault((t, j), []).append((e, s, i))
        return out

    def _slots(self, which):
        m = (self.a, self.b)[which]
        rows = (m.branches[v] - self.grid[which] for v in range(len(m)))
        return [[round(wrap(h) / QUARTER) % 4 for h in row.tolist()] for row in rows]

    def correspondences(self, u, v) -> Iterator[Correspondence]:
        """All ways in which u of a and v of b are compatible (§2.1)."""
        if self.rectilinear:
            found = (self._turned(u, v, r) for r in range(4))
        else:
            anchors = product(range(len(self.a.branches[u])), range(len(self.b.branches[v])))
            found = (self._anchored(u, v, i, j) for i, j in anchors)
        return iter(sorted({c for c in found if c is not None}))

    def _turned(self, u, v, r):
        at_a = {s: i for i, s in enumerate(self.slots[0][u])}
        at_b = {(s + r) % 4: j for j, s in enumerate(self.slots[1][v])}
        common = set(at_a) & set(at_b)
        spare = self.settings.unmatched_branches if self.settings.degree == "inexact" else 0
        if not common or max(len(set(at_a) - common), len(set(at_b) - common)) > spare:
            return None
        return tuple(sorted((at_a[s], at_b[s]) for s in common))

    def _anchored(self, u, v, i, j):
        ha, hb = self.a.branches[u], self.b.branches[v]
        tolerance = self.settings.branch_tolerance_rad
        if self.settings.degree == "exact":
            if len(ha) != len(hb):
                return None
            pairs = [(k, (k + j - i) % len(hb)) for k in range(len(ha))]
            anchor = ha[i] - hb[j]
            diff = np.array([wrap(ha[k] - hb[h] - anchor) for k, h in pairs])
            return tuple(pairs) if np.abs(diff - diff.mean()).max() <= tolerance else None
        turn = ha[i] - hb[j]
        for _ in range(2):
            pairs = self._nearest(ha, hb, turn, tolerance)
            if not pairs:
                return None
            anchor = ha[i] - hb[j]
            turn = anchor + np.mean([wrap(ha[k] - hb[h] - anchor) for k, h in pairs])
        spare = self.settings.unmatched_branches
        fits = len(ha) - len(pairs) <= spare and len(hb) - len(pairs) <= spare
        return tuple(pairs) if fits and (i, j) in pairs else None

    @staticmethod
    def _nearest(ha, hb, turn, tolerance):
        off = np.abs([[wrap(x - y - turn) for y in hb] for x in ha])
        return [
            (k, h)
            for k in range(len(ha))
            for h in [int(np.argmin(off[k]))]
            if int(np.argmin(off[:, h])) == k and off[k, h] <= tolerance
        ]

    def turn(self, u, i, v, j):
        """Quarter turns of b under which branch j of v points as branch i of u does."""
        return (self.slots[0][u][i] - self.slots[1][v][j]) % 4

    def arrive(self, node: Node, far: tuple[int, int, int, int]) -> Correspondence | None:
        """The correspondence of x and y in which branch p goes with branch q, if compatible.

        In a rectilinear world orientations are exact: the whole match has one rotation (§2.3).
        """
        x, p, y, q = far
        if not self.rectilinear:
            return self._anchored(x, y, p, q)
        u, v, correspondence = node
        i, j = correspondence[0]
        r = self.turn(x, p, y, q)
        return self._turned(x, y, r) if r == self.turn(u, i, v, j) else None

    def lengths_agree(self, e, f):
        a, b = self.a, self.b
        assert self.settings.confidence_of == "corridor"  # of the whole match has tests of its own
        bound = self.settings.bound_sigmas(1) * np.hypot(a.length_sigma[e], b.length_sigma[f])
        return abs(a.length[e] - b.length[f]) <= bound

    def hypotheses(self) -> tuple[set[frozenset[Node]], set[Node]]:
        """Surviving matches, and the nodes of rejected ones, with the table of §2.2."""
        table: set[Node] = set()
        good, bad = set(), set()
        for u, v in product(range(len(self.a)), range(len(self.b))):
            for c in self.correspondences(u, v):
                if (u, v, c) in table:
                    continue
                match: set[Node] = set()
                valid = self._grow((u, v, c), match)
                table |= match
                valid &= len({n[0] for n in match}) == len(match) == len({n[1] for n in match})
                if valid:
                    good.add(frozenset(match))
                else:
                    bad |= match
        return good, bad

    def _grow(self, node: Node, match: set[Node]) -> bool:
        """Grow from a node; the rest is grown even after a conflict, so that it is all marked."""
        match.add(node)
        u, v, correspondence = node
        valid = True
        for i, j in correspondence:
            ours, theirs = self.edges_a.get((u, i), []), self.edges_b.get((v, j), [])
            if not ours or not theirs:
                continue  # unexplored in one of the maps
            fitting = False
            for (e, x, p), (f, y, q) in product(ours, theirs):
                agree = self.lengths_agree(e, f)
                there = self.arrive(node, (x, p, y, q)) if agree else None
                if there is not None:
                    fitting = True
                    if (x, y, there) not in match:
                        valid &= self._grow((x, y, there), match)
            valid &= fitting
        return valid


# --- random small maps with everything that is awkward --------------------------------------------

SQUARE = [np.array(s) * QUARTER for s in ([0], [0, 1], [0, 2], [0, 1, 2], [0, 1, 3], [0, 1, 2, 3])]
STARS = [
    np.array(s)
    for s in (
        [0.3],
        [0.0, 2.1],
        [0.0, 2.1, -2.1],
        [0.0, 0.8, 2.6],
        [0.0, 1.2, 2.5, -1.6],
        [0.0, 3.1],
    )
]
LENGTHS = np.array([3.0, 4.0, 4.3, 6.0])


def random_map(rng, rectilinear, turn=0.0):
    """A random multigraph: free branches joined at random, so loops and parallels are common."""
    shapes = SQUARE if rectilinear else STARS
    rows, n = [], int(rng.integers(2, 6))
    for _ in range(n):
        shape = shapes[rng.integers(len(shapes))]
        own = rng.integers(4) * QUARTER if rectilinear else rng.uniform(-np.pi, np.pi)
        noise = rng.normal(0, 0.03, len(shape))
        rows.append(np.sort(wrap(shape + own + turn + noise)))
    ends = [(v, i) for v in range(n) for i in range(len(rows[v]))]
    rng.shuffle(ends)
    count = int(rng.integers(0, len(ends) // 2 + 1))
    edges = [
        (
            *map(int, ends[2 * k]),
            *map(int, ends[2 * k + 1]),
            rng.choice(LENGTHS) + rng.normal(0, 0.05),
        )
        for k in range(count)
    ]
    if rng.random() < 0.15 and edges:  # a second corridor by a branch that is taken
        u, i, _, _, length = edges[0]
        edges.append((u, i, int(rng.integers(n)), 0, length + 3.0))
    return rows, edges


def altered(rng, rows, edges, turn):
    """The same map turned, renumbered, measured again, some corridors unexplored or wrong."""
    order = rng.permutation(len(rows))
    place = np.argsort(order)
    new_rows, branch = [], {}
    for v in order:
        moved = wrap(rows[v] + turn + rng.normal(0, 0.02, len(rows[v])))
        rank = np.argsort(moved)
        branch[int(v)] = np.argsort(rank)
        new_rows.append(moved[rank])
    out = []
    for u, i, v, j, length in edges:
        if rng.random() < 0.2:
            continue
        wrong = 1.5 if rng.random() < 0.05 else 0.0
        ends = (int(place[u]), int(branch[u][i]), int(place[v]), int(branch[v][j]))
        if rng.random() < 0.5:
            ends = ends[2:] + ends[:2]
        out.append((*ends, length + wrong + rng.normal(0, 0.05)))
    return new_rows, out


def random_pair(seed, rectilinear):
    rng = np.random.default_rng(seed)
    rows, edges = random_map(rng, rectilinear)
    turn = rng.uniform(-np.pi, np.pi)
    if rng.random() < 0.6:
        other = altered(rng, rows, edges, turn)
    else:
        other = random_map(rng, rectilinear, turn)
    sigma = rng.uniform(0.05, 0.4, 2)
    return topomap(rows, edges, sigma[0], "a"), topomap(*other, sigma[1], "b")


def as_node(a: Structure, b: Structure, rectilinear, node) -> Node:
    """A node of the engine in the oracle's terms."""
    u, v, code = node
    if rectilinear:
        at_b = {(int(s) + code) % 4: j for j, s in enumerate(b.slot[v]) if s >= 0}
        pairs = [(i, at_b[int(s)]) for i, s in enumerate(a.slot[u]) if int(s) in at_b]
        return u, v, tuple(sorted(pairs))
    row = partners(a, b, np.array([code]))[0]
    return u, v, tuple((i, int(j)) for i, j in enumerate(row) if j >= 0)


def nodes_of(a, b, rectilinear, nodes):
    columns = (nodes.vertex_a, nodes.vertex_b, nodes.correspondence)
    return [as_node(a, b, rectilinear, map(int, row)) for row in zip(*columns, strict=True)]


def engine_hypotheses(a: Structure, b: Structure, settings):
    growth = grow(a, b, settings)
    nodes = nodes_of(a, b, growth.rectilinear, growth.nodes)
    matches = {}
    for node, c in zip(nodes, growth.component.tolist(), strict=True):
        matches.setdefault(c, set()).add(node)
    good = {frozenset(m) for c, m in matches.items() if not growth.rejected[c]}
    singles = single_matches(a, b, growth, settings)
    good |= {frozenset([n]) for n in nodes_of(a, b, growth.rectilinear, singles.nodes)}
    bad = set().union(*(m for c, m in matches.items() if growth.rejected[c]))
    return good, bad, growth


@pytest.mark.parametrize("degree", ["exact", "inexact"])
@pytest.mark.parametrize("rectilinear", [True, False])
def test_growth_agrees_with_plain_recursion(rectilinear, degree):
    world = "auto" if rectilinear else "general"
    settings = GrowthSettings(world, degree, confidence=0.95, confidence_of="corridor")
    grown = rejected = 0
    for seed in range(40):
        a, b = random_pair(seed, rectilinear)
        sa, sb = prepare(a), prepare(b)
        if rectilinear and (sa.grid_rad is None or sb.grid_rad is None):
            continue
        good, bad = Oracle(a, b, settings, rectilinear).hypotheses()
        ours, marked, growth = engine_hypotheses(sa, sb, settings)
        assert growth.rectilinear == rectilinear
        assert ours == good, f"seed {seed}"
        # What the engine marks is rejected; lone nodes that fail at once are in no component.
        assert marked <= bad
        grown += sum(len(h) > 1 for h in good)
        rejected += len(bad) > 0
    assert grown > 10
    assert rejected > 10


# --- special cases by hand ------------------------------------------------------------------------


def survivors(growth: Growth) -> list[set[Pair]]:
    pairs = zip(growth.nodes.vertex_a.tolist(), growth.nodes.vertex_b.tolist(), strict=True)
    out = {}
    for pair, c in zip(pairs, growth.component.tolist(), strict=True):
        if not growth.rejected[c]:
            out.setdefault(c, set()).add(pair)
    return sorted(out.values(), key=lambda m: (-len(m), sorted(m)))


E, N, W, S = 0.0, QUARTER, -np.pi, -QUARTER


def test_square_ring_matches_itself_under_its_four_rotations():
    corners = [[E, N], [N, W], [W, S], [S, E]]
    rows = [np.sort(c) for c in corners]

    def at(v, h):
        return int(np.flatnonzero(rows[v] == h)[0])

    edges = [
        (0, at(0, E), 1, at(1, W), 4.0),
        (1, at(1, N), 2, at(2, S), 4.0),
        (2, at(2, W), 3, at(3, E), 4.0),
        (3, at(3, S), 0, at(0, N), 4.0),
    ]
    ring = prepare(topomap(rows, edges))
    found = survivors(grow(ring, ring))
    assert [len(m) for m in found] == [4, 4, 4, 4]
    shifts = {tuple(sorted((u, v) for u, v in m)) for m in found}
    assert shifts == {tuple((u, (u + k) % 4) for u in range(4)) for k in range(4)}


def test_unexplored_branches_are_no_conflict_but_a_missing_branch_is():
    cross, tee = np.array([W, S, E, N]), np.array([W, E, N])
    a = prepare(topomap([cross, cross], [(0, 2, 1, 0, 5.0)]))
    b = prepare(topomap([cross, cross, cross], [(0, 2, 1, 0, 5.0), (1, 2, 2, 0, 7.0)]))
    assert {(0, 0), (1, 1)} in survivors(grow(a, b))
    c = prepare(topomap([cross, tee], [(0, 2, 1, 0, 5.0)]))
    assert survivors(grow(a, c)) == []
    inexact = GrowthSettings(degree="inexact")
    assert {(0, 0), (1, 1)} in survivors(grow(a, c, inexact))


def test_maps_without_edges_or_vertices():
    empty = prepare(topomap([], []))
    lone = prepare(topomap([np.array([E, N])], []))
    for a, b in product((empty, lone), repeat=2):
        growth = grow(a, b)
        assert len(growth.nodes) == 0
        singles = single_matches(a, b, growth)
        assert singles.candidates == (a is lone and b is lone)


def grown(growth: Growth, kept):
    """The kept matches: their nodes, links, and whether they were rejected."""
    n, k = growth.nodes, growth.links
    return sorted(
        (
            bool(growth.rejected[c]),
            int(growth.tested[c]),
            int(growth.agreed[c]),
            [x[growth.component == c].tolist() for x in (n.vertex_a, n.vertex_b, n.correspondence)],
            sorted(np.stack(k, axis=1)[growth.link_component == c].tolist()),
        )
        for c in np.flatnonzero(kept).tolist()
    )


@pytest.mark.parametrize("rectilinear", [True, False])
def test_matches_grown_from_some_nodes_are_whole(rectilinear):
    settings = GrowthSettings(world="auto" if rectilinear else "general")
    some = left_out = 0
    for seed in range(30):
        a, b = (prepare(m) for m in random_pair(seed, rectilinear))
        whole = grow(a, b, settings)
        chosen = np.random.default_rng(seed).random(len(whole.nodes)) < 0.2
        kept = np.isin(np.arange(len(whole.rejected)), whole.component[chosen])
        part = grow(a, b, settings, seeds=take(whole.nodes, chosen))
        assert grown(part, np.ones(len(part.rejected), bool)) == grown(whole, kept)
        some += np.count_nonzero(kept)
        left_out += np.count_nonzero(~kept)
    assert some > 3
    assert left_out > 3


def test_the_bound_on_lengths_holds_for_the_whole_match():
    corridor = GrowthSettings(confidence=0.95, confidence_of="corridor")
    assert corridor.bound_sigmas(1) == pytest.approx(1.96, abs=0.001)
    assert corridor.bound_sigmas(50) == corridor.bound_sigmas(1)
    whole = GrowthSettings(confidence=0.95)
    assert whole.bound_sigmas(1) == corridor.bound_sigmas(1)
    z = np.random.default_rng(0).normal(size=(20_000, 30))
    assert np.mean(np.abs(z).max(axis=1) <= whole.bound_sigmas(30)) == pytest.approx(0.95, abs=0.01)
    shared = 0.8 * z + 0.6 * z[:, :1]  # an error common to all lengths: survival is no less likely
    assert np.mean(np.abs(shared).max(axis=1) <= whole.bound_sigmas(30)) >= 0.945
    for nonsense in (0.0, 1.0, 2.0):
        with pytest.raises(UsageError, match="confidence"):
            GrowthSettings(confidence=nonsense)


@pytest.mark.parametrize(("corridors", "survives"), [(1, False), (8, True)])
def test_a_longer_match_may_hold_a_larger_difference(corridors, survives):
    """3.5 sigma is too much for one corridor, and within the bound of eight."""
    east, west = 0.0, -np.pi
    n = corridors + 1
    branches = [[east], *([[west, east]] * (n - 2)), [west]] if n > 2 else [[east], [west]]
    edges = [(k, 0 if k == 0 else 1, k + 1, 0, 5.0 + k) for k in range(corridors)]
    a = topomap(branches, edges)
    length = a.length.copy()
    length[0] += 3.5 * np.hypot(0.1, 0.1)
    b = replace(a, length=length)
    growth = grow(prepare(a), prepare(b), GrowthSettings())
    whole = {(k, k) for k in range(n)}
    assert (whole in survivors(growth)) == survives
