"""Centres of junctions in a skeleton, where the axes of its corridors cross, and headings of
branches.

A skeleton forks at discs that touch walls on three sides, not where the axes of the corridors meet:
at acute angles up to a corridor's width away, and moved by every niche and pillar. The axes are
measured farther out, if the branches are corridors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logit

from ...topology.arrays import BoolArray, Float32Array, FloatArray
from ...topology.se2 import wrap
from .grid import GridSettings
from .skeleton import Node, SkeletonGraph, SkeletonSettings

AXIS_M = 3.0
"""Length of a branch that its axis is fitted to, beyond the widening: half of what a window shows.
At 2 m furniture passes for corridors (repeatability .86 for .89 in one real building), at 4 m
niches keep straight ones from being any (centres off by .06 for .045 m in simulated offices and
tunnels)."""

BENT_PER_M = 0.03
"""1 sigma of the deviation of a bent corridor's axis from a straight line, per squared distance
along it (half its curvature). Half and twice of it move simulated centres by 1 cm."""

APART_M = 0.3
"""Correlation length of the deviations of an axis's cells. Counting each cell as independent would
fit bends to objects along straight corridors (centres in simulated rows and mazes off by 5 and 6 cm
for 3.5 and 4)."""

ANGLES_RAD = (np.pi / 6, np.pi / 2)
"""Range to which the smallest angle between two branches is clipped."""

FORK_SHARE = 0.07
"""1 sigma, in clearances, of the deviation of a fork of perpendicular corridors from its
theoretical position: .03 to .13 in five kinds of simulated world, more in organic streets."""

ROUGH_M = GridSettings().cell_m
"""Lower bound of the rounding error of walls: they are no smoother in finer grids."""


SHARES = (np.arange(20) + 0.5) / 20
"""Possible shares of a run's axes that bend, with equal prior probabilities."""


@dataclass(slots=True)
class BendTally:
    """Posterior of the share of a run's axes that bend. weight: of an axis; log: (20,) log
    likelihood [nats] of each of the `SHARES`; axes too short to decide leave it unchanged."""

    weight: float = 1.0
    log: FloatArray = field(default_factory=lambda: np.zeros(len(SHARES)))

    @property
    def usual(self) -> float:
        """Prior probability that an axis bends: the posterior mean of the share."""
        likelihood = np.exp(self.log - self.log.max())
        return float((likelihood * SHARES).sum() / likelihood.sum())

    def add(self, odds: Sequence[float]) -> None:
        """Add axes with log odds [nats] that each bends, by its own cells alone."""
        bent = np.logaddexp(np.log1p(-SHARES), np.log(SHARES) + np.array(odds)[:, None])
        self.log += self.weight * bent.sum(axis=0)


def placed(graph: SkeletonGraph, node: Node, tally: BendTally | None = None) -> Node:
    """A node of a graph at the crossing of the axes of its branches.

    tally: of the axes seen before, updated, None if there is none.
    """
    tally = BendTally() if tally is None else tally
    usual, seen = tally.usual, [_Cells.of(graph, way, node) for way in node.ends]
    begins = _begins(node, seen).tolist()
    branches = [
        _branch(cells, node, begin, graph.cell_m, usual=usual, ring=node.ends.count(way) > 1)
        for way, cells, begin in zip(node.ends, seen, begins, strict=True)
    ]
    tally.add([branch.axis.bend.odds for branch in branches if branch.axis is not None])
    xy, sigma_m = _centre(node, branches)
    return Node(xy, node.clearance_m, node.ends, sigma_m)


def crossing(graph: SkeletonGraph, node: Node, settings: SkeletonSettings) -> Node:
    """A placed node of a graph with the headings of its branches."""
    headings = _headings(node.xy, graph, node.ends, _reach(node, settings))
    order = np.argsort(headings, kind="stable")
    ends = tuple(node.ends[k] for k in order)
    return replace(node, ends=ends, headings=headings[order])


def bends(graph: SkeletonGraph, place: Node, settings: SkeletonSettings) -> FloatArray:
    """(b,) change of heading [rad] of each branch between the distance where it is measured and
    twice that; NaN where it ends before, or for the two ends of a ring."""
    reach = 2 * _reach(place, settings)
    far = [np.hypot(*graph.edges[k].away(place.xy, graph.cell_m).T) for k in place.ends]
    known = [
        place.ends.count(way) == 1 and away.max(initial=0.0) >= reach
        for way, away in zip(place.ends, far, strict=True)
    ]
    further = _headings(place.xy, graph, place.ends, reach)
    return np.where(known, wrap(further - place.headings), np.nan)


def _reach(node: Node, settings: SkeletonSettings) -> float:
    """Distance from a node at which headings are measured [m]."""
    return max(settings.chord_m, node.clearance_m + settings.chord_beyond_m)


class Crossings(NamedTuple):
    """Placed nodes of a graph, by number; joints: for every edge within one junction, the number of
    the node that was merged, and of that which represents both."""

    places: dict[int, Node]
    joints: dict[int, tuple[int, int]]


def crossings(
    graph: SkeletonGraph,
    numbers: Sequence[int],
    settings: SkeletonSettings,
    tally: BendTally | None = None,
) -> Crossings:
    """Nodes `numbers` of a graph, placed; tally: see `placed`. Two ends of one edge whose
    axes cross at one point are merged: a skeleton may show a crossing of many branches as two forks
    farther apart than `join_m`, whose centres are nearer."""
    found = {
        k: placed(graph, graph.nodes[k], tally)
        if graph.nodes[k].clearance_m <= settings.axes_m
        else graph.nodes[k]
        for k in numbers
    }
    joints: dict[int, tuple[int, int]] = {}
    for way, edge in enumerate(graph.edges):
        a, b = edge.nodes
        if a == b or a not in found or b not in found:
            continue
        one, other = found[a], found[b]
        apart = float(np.hypot(*(one.xy - other.xy)))
        if apart >= settings.join_m or edge.length_m >= 2 * settings.join_m:
            continue
        ends = tuple(k for k in (*one.ends, *other.ends) if k != way)
        amid = Node(0.5 * (one.xy + other.xy), max(one.clearance_m, other.clearance_m), ends)
        found[a] = placed(graph, amid, tally)
        del found[b]
        joints[way] = b, a
    return Crossings(found, joints)


def with_crossings(graph: SkeletonGraph, settings: SkeletonSettings) -> SkeletonGraph:
    """A graph with its nodes placed; two forks of one crossing become one node, and the edge
    between them is removed."""
    found, joints = crossings(graph, range(len(graph.nodes)), settings)
    kept, ways = sorted(found), [k for k in range(len(graph.edges)) if k not in joints]
    number = {k: new for new, k in enumerate(kept)}
    # What a node was joined to may have been joined to another one later.
    for gone, into in reversed(joints.values()):
        number[gone] = number[into]
    way_number = {k: new for new, k in enumerate(ways)}
    crossed = [crossing(graph, found[k], settings) for k in kept]
    places = tuple(replace(c, ends=tuple(way_number[way] for way in c.ends)) for c in crossed)
    edges = []
    for edge in (graph.edges[way] for way in ways):
        a, b = (number.get(node, -1) for node in edge.nodes)
        edges.append(replace(edge, nodes=(a, b)))
    return replace(graph, nodes=places, edges=tuple(edges))


class _Bend(NamedTuple):
    """Bend of an axis: at s [m] along it from its middle, it deviates by bent (s² - spread - skew
    s), with the variance `variance` of `bent`.

    odds: log odds [nats] that it bends, by its cells alone; left: mean squared residual of its
    cells [m²].
    """

    spread: float
    skew: float
    bent: float
    variance: float
    odds: float
    left: float


class _Axis(NamedTuple):
    """The axis of a branch: middle (2,), normal (2,) there, variance of its lateral position [m²]
    and of its direction [rad²], and its bend."""

    middle: FloatArray
    normal: FloatArray
    variance: float
    turn_variance: float
    bend: _Bend


class _Branch(NamedTuple):
    """A branch beyond the widening of its node: bearing [rad] of its axis or, without one, of the
    centroid of its cells."""

    bearing: float
    axis: _Axis | None


class _Cells(NamedTuple):
    """Cells of a branch: their offsets (n, 2) and distances (n,) from its node [m], and their
    clearance (n,) [m]."""

    away: FloatArray
    distance: FloatArray
    clearance_m: Float32Array | FloatArray

    @classmethod
    def of(cls, graph: SkeletonGraph, way: int, node: Node) -> _Cells:
        """The cells of an edge of a graph, relative to one of its nodes."""
        edge = graph.edges[way]
        away = edge.away(node.xy, graph.cell_m)
        return cls(away, np.hypot(away[:, 0], away[:, 1]), graph.clearance_m[tuple(edge.cells.T)])

    def axis(self, begin_m: float) -> tuple[BoolArray, FloatArray]:
        """(n,) which cells an axis that begins at `begin_m` is fitted to, and their offsets; all
        offsets if there are none."""
        beyond = (self.distance >= begin_m) & (self.distance <= begin_m + AXIS_M)
        return beyond, self.away[beyond] if beyond.any() else self.away


def _begins(node: Node, branches: Sequence[_Cells]) -> FloatArray:
    """(b,) distance at which the widening of each branch of a node ends [m]: its clearance or, for
    corridors of equal width at an acute angle a, cot(a / 2) half widths, where their walls meet."""
    toward = np.array([cells.axis(node.clearance_m)[1].sum(axis=0) for cells in branches])
    bearings = np.arctan2(toward[:, 1], toward[:, 0])
    apart = np.abs(wrap(bearings[:, None] - bearings))
    np.fill_diagonal(apart, np.pi)
    a = np.clip(apart.min(axis=0), *ANGLES_RAD)
    return np.asarray(node.clearance_m * np.maximum(1.0, 1 / np.tan(a / 2) / (1 + _towards(a))))


def _branch(
    seen: _Cells,
    node: Node,
    begin_m: float,
    cell_m: float,
    *,
    usual: float,
    ring: bool,
) -> _Branch:
    """A branch with its axis, if it is a corridor: nearly straight and of constant width, up to the
    rounding of cells.

    begin_m: distance of its start from the node [m]; usual: prior probability that the axis bends;
    ring: whether both ends of the edge are at this node.
    """
    beyond, own = seen.axis(begin_m)
    middle = own.sum(axis=0) / max(len(own), 1)
    without = _Branch(float(np.arctan2(middle[1], middle[0])), None)
    # Two cells make a line, where cells are large.
    if ring or np.count_nonzero(beyond) < max(0.4 * AXIS_M / cell_m, 2):
        return without
    rounding, wide = max(cell_m, ROUGH_M) ** 2 / 12, float(seen.clearance_m[beyond].var())
    u, v = (own - middle).T
    angle = 0.5 * np.arctan2(2 * float(u @ v), float(u @ u) - float(v @ v))
    if np.cos(angle) * middle[0] + np.sin(angle) * middle[1] < 0:
        angle += np.pi
    c, s = np.cos(angle), np.sin(angle)
    bend = _bend(c * u + s * v, c * v - s * u, (rounding, wide), usual)
    unlike = 0.5 * (max(bend.left, 0.0) + wide) / rounding
    # Beyond three sigma it is none; exp would overflow.
    if unlike >= 4.5:
        return without
    of_mean = float(np.exp(unlike)) * rounding / len(own)
    # All cells of an axis along the grid are rounded alike.
    known = (rounding + of_mean, of_mean / bend.spread)
    return _Branch(float(angle), _Axis(middle + node.xy, np.array([-s, c]), *known, bend))


def _bend(along: FloatArray, across: FloatArray, noise: tuple[float, float], usual: float) -> _Bend:
    """The bend of cells (n,) along and across the best-fitting straight line [m].

    noise: variances [m²] of rounding, and of the corridor's width: objects in the corridor are not
    a bend. An axis is straight, or bends by a normal number of sigma BENT_PER_M, with the prior
    probability `usual`.
    """
    count, square = len(along), along * along
    spread = float(square.sum()) / count
    skew = float(square @ along) / count / spread
    # Variance of s² that a straight line does not explain.
    told = max(float(square @ square) / count - spread * spread - skew * skew * spread, 1e-9)
    shown, strays = float(square @ across) / count, float(across @ across) / count
    rounding, wide = noise
    readings = min(count, AXIS_M / APART_M) / max(rounding, strays - shown * shown / told + wide)
    if_bent = 1 / (readings * told + BENT_PER_M**-2)
    by = if_bent * readings * shown
    odds = 0.5 * (by * by / if_bent + np.log(if_bent / BENT_PER_M**2))
    likely = float(expit(odds + logit(usual)))
    bent = likely * by
    left = strays - (2 * shown - bent * told) * bent
    return _Bend(spread, skew, bent, likely * (if_bent + (1 - likely) * by * by), float(odds), left)


def _centre(node: Node, branches: list[_Branch]) -> tuple[FloatArray, float]:
    """(2,) maximum-likelihood position from the axes and the node itself, within the node's disc; 1
    sigma of each coordinate [m].

    Forks deviate more than expected at rounded corners and niches: the node has a Cauchy kernel, so
    that axes that agree on another point win.
    """
    beside = aside(np.array([b.bearing for b in branches])) * node.clearance_m**2
    axes = [branch.axis for branch in branches if branch.axis is not None]
    if len(axes) < 2:
        return node.xy, float(np.sqrt(0.5 * np.trace(beside)))
    middle, normal = np.array([a.middle for a in axes]), np.array([a.normal for a in axes])
    variance, turn = np.array([(a.variance, a.turn_variance) for a in axes]).T
    bends = _Bend(*np.array([a.bend for a in axes]).T)
    on_axis = np.einsum("ij,ij->i", normal, middle)
    by_fork = np.linalg.inv(beside)
    xy, kernel, information = node.xy, 1.0, by_fork
    for _ in range(3):
        # The variance of an axis grows with the distance from the middle of its cells.
        off = xy - middle
        along = off[:, 0] * normal[:, 1] - off[:, 1] * normal[:, 0]
        bow = along * along - bends.spread - bends.skew * along
        weight = 1.0 / (variance + turn * along * along + bends.variance * bow * bow)
        information = kernel * by_fork + np.einsum("i,ij,ik->jk", weight, normal, normal)
        right = kernel * by_fork @ node.xy + (weight * (on_axis + bends.bent * bow)) @ normal
        xy = np.linalg.solve(information, right)
        moved = xy - node.xy
        kernel = 1 / (1 + float(moved @ by_fork @ moved))
    # Trace of the inverse of a symmetric 2 × 2 matrix: trace / determinant.
    sigma_m = float(np.sqrt(0.5 * np.trace(information) / np.linalg.det(information)))
    far_off = float(np.hypot(*moved))
    if far_off > node.clearance_m:
        xy = node.xy + moved * (node.clearance_m / far_off)
    return xy, sigma_m


def aside(bearings: FloatArray) -> FloatArray:
    """(2, 2) covariance of the offset of a fork from where the axes cross, in squared clearances.

    For a corridor of half width h and one of equal width that leaves it at an angle a, the disc
    that touches the far wall and both corners lies h cot a along and h / (4 sin² a) aside, and its
    radius exceeds h by the latter. Because corridors bend, h cot a counts in every direction. Where
    two corridors cross, the fork is at their centre.
    """
    least = FORK_SHARE**2 * np.eye(2)
    if len(bearings) != 3:
        return least
    turned = np.sort(bearings)
    # The two that are most nearly opposite are the corridor that the third one leaves.
    third = (int(np.argmax(np.abs(wrap(turned - np.roll(turned, 1))))) + 1) % 3
    corridor = np.delete(turned, third)
    a = np.clip(np.abs(wrap(turned[third] - corridor)).min(), *ANGLES_RAD)
    towards = _towards(a)
    # Both ends are used: which one sorts first is arbitrary where one points along the grid.
    s, c = (of(corridor[0]) - of(corridor[1]) for of in (np.sin, np.cos))
    across = np.array([-s, c]) / np.hypot(s, c)
    spread = np.tan(a) ** -2.0 * np.eye(2) + towards**2 * np.outer(across, across)
    return np.asarray(least + spread / (1 + towards) ** 2)


def _towards(angle: FloatArray | float) -> FloatArray | float:
    """Radius of the disc at a fork minus that of its corridors, in half widths."""
    return 0.25 / np.sin(angle) ** 2


def _headings(
    centre: FloatArray, graph: SkeletonGraph, ways: tuple[int, ...], reach_m: float
) -> FloatArray:
    """(b,) headings [rad] of the chords from a node to where its edges cross a circle about it."""
    out, cell_m = np.zeros(len(ways)), graph.cell_m
    used: dict[int, float] = {}
    for k, way in enumerate(ways):
        away = graph.edges[way].away(centre, cell_m)
        if len(away) == 0:
            continue
        off = np.abs(np.hypot(away[:, 0], away[:, 1]) - reach_m)
        if way in used:
            # A ring comes back: its other end crosses the circle elsewhere.
            heading = np.arctan2(away[:, 1], away[:, 0])
            apart = np.abs(wrap(heading - used[way])) > 0.5
            off = np.where(apart, off, np.inf)
        best = int(np.argmin(off))
        near = off <= off[best] + 0.5 * cell_m
        # Mean over the cells on the circle that belong to the same crossing.
        same = near & (np.hypot(*(away - away[best]).T) < 4 * cell_m)
        mean = away[same].mean(axis=0)
        out[k] = used[way] = wrap(np.arctan2(mean[1], mean[0]))
    return out
