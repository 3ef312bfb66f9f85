"""Centres of junctions in a skeleton, where the axes of its corridors cross, and headings of
branches.

A skeleton forks at discs that touch walls on three sides, not where the axes of the corridors meet:
at acute angles up to a corridor's width away, and moved by every niche and pillar. The axes are
measured farther out, if the branches are corridors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from ...topology.arrays import BoolArray, FloatArray, IntArray
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


def placed(graph: SkeletonGraph, nodes: Sequence[Node]) -> list[Node]:
    """Nodes of a graph, each moved to where the axes of its branches cross. Vectorised over the
    nodes of one degree."""
    out, degrees = list(nodes), np.array([len(node.ends) for node in nodes])
    for degree in np.unique(degrees).tolist():
        alike = np.flatnonzero(degrees == degree).tolist()
        forks = _Forks.of(graph, [nodes[k] for k in alike])
        bearings, axes = _axes(forks)
        for k, xy, sigma_m in zip(alike, *_centres(forks, bearings, axes), strict=True):
            out[k] = replace(nodes[k], xy=xy, sigma_m=sigma_m)
    return out


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
    graph: SkeletonGraph, numbers: Sequence[int], settings: SkeletonSettings
) -> Crossings:
    """Nodes `numbers` of a graph, placed. Two ends of one edge whose axes cross at one point are
    merged: a skeleton may show a crossing of many branches as two forks farther apart than
    `join_m`, whose centres are nearer."""
    found = {k: graph.nodes[k] for k in numbers}
    narrow = [k for k, node in found.items() if node.clearance_m <= settings.axes_m]
    found |= zip(narrow, placed(graph, [found[k] for k in narrow]), strict=True)
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
        (found[a],) = placed(graph, [amid])
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
    """Bends of axes (a,): at s [m] along one from its middle, it deviates by bent (s² - spread -
    skew s), with the variance `variance` of `bent`; left: mean squared residual of its cells [m²].
    """

    spread: FloatArray
    skew: FloatArray
    bent: FloatArray
    variance: FloatArray
    left: FloatArray


class _Axes(NamedTuple):
    """Axes of branches: fork (a,) of each, middle (a, 2), normal (a, 2) there, variance (a,) of its
    lateral position [m²] and of its direction [rad²], and its bend."""

    fork: IntArray
    middle: FloatArray
    normal: FloatArray
    variance: FloatArray
    turn_variance: FloatArray
    bend: _Bend


class _Forks(NamedTuple):
    """Forks (n,) of b branches each, and the cells (c,) of these: xy (n, 2), clearance_m (n,); ring
    (n b,): whether both ends of the branch's edge are at its fork; branch (c,) of each cell, its
    offset (c, 2) and distance (c,) from its fork [m], and its distance from walls (c,) [m]."""

    xy: FloatArray
    clearance_m: FloatArray
    ring: BoolArray
    branch: IntArray
    away: FloatArray
    distance: FloatArray
    cell_clearance_m: FloatArray
    cell_m: float

    @classmethod
    def of(cls, graph: SkeletonGraph, nodes: Sequence[Node]) -> _Forks:
        """Nodes of a graph, all of one degree."""
        xy = np.array([node.xy for node in nodes])
        ways = [graph.edges[way].cells for node in nodes for way in node.ends]
        ring = np.array([node.ends.count(way) > 1 for node in nodes for way in node.ends])
        branch = np.repeat(np.arange(len(ways)), [len(cells) for cells in ways])
        cells = np.concatenate(ways)
        away = cells[:, ::-1] * graph.cell_m - xy[branch // len(nodes[0].ends)]
        clear = graph.clearance_m[tuple(cells.T)].astype(np.float64)
        narrowest = np.array([node.clearance_m for node in nodes])
        return cls(xy, narrowest, ring, branch, away, np.hypot(*away.T), clear, graph.cell_m)

    def beyond(self, begin_m: FloatArray) -> tuple[BoolArray, IntArray, FloatArray]:
        """(c,) the cells of branches that axes which begin at `begin_m` (n, b) are fitted to, and
        (n b,) their number; the sum (n b, 2) of their offsets, of all offsets where there are none.
        """
        count, begin = len(self.ring), begin_m.ravel()[self.branch]
        beyond = (self.distance >= begin) & (self.distance <= begin + AXIS_M)
        number = np.bincount(self.branch[beyond], minlength=count)
        own = beyond | (number == 0)[self.branch]
        sums = [np.bincount(self.branch[own], off[own], count) for off in self.away.T]
        return beyond, number, np.stack(sums, axis=1)


def _begins(forks: _Forks) -> FloatArray:
    """(n, b) distance at which the widening of each branch ends [m]: its fork's clearance or, for
    corridors of equal width at an acute angle a, cot(a / 2) half widths, where their walls meet."""
    n = len(forks.xy)
    clearance = np.repeat(forks.clearance_m[:, None], len(forks.ring) // n, axis=1)
    _, _, toward = forks.beyond(clearance)
    bearings = np.arctan2(toward[:, 1], toward[:, 0]).reshape(n, -1)
    apart = np.abs(wrap(bearings[:, :, None] - bearings[:, None]))
    apart += np.pi * np.eye(bearings.shape[1])
    a = np.clip(apart.min(axis=1), *ANGLES_RAD)
    return np.asarray(clearance * np.maximum(1.0, 1 / np.tan(a / 2) / (1 + _towards(a))))


def _axes(forks: _Forks) -> tuple[FloatArray, _Axes]:
    """The bearings (n, b) [rad] of branches beyond the widening of their forks, and the axes of
    those that are corridors: nearly straight and of constant width, up to the rounding of cells.
    The bearing of others is that of the centroid of their cells."""
    beyond, number, toward = forks.beyond(_begins(forks))
    bearings = np.arctan2(toward[:, 1], toward[:, 0])
    # Two cells make a line, where cells are large.
    long = ~forks.ring & (number >= max(0.4 * AXIS_M / forks.cell_m, 2))
    cells = beyond & long[forks.branch]
    lines, line = np.flatnonzero(long), (np.cumsum(long) - 1)[forks.branch[cells]]
    count = number[lines]

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(line, values, len(lines)) / count)

    middle, clear = toward[lines] / count[:, None], forks.cell_clearance_m[cells]
    rounding = max(forks.cell_m, ROUGH_M) ** 2 / 12
    wide = mean((clear - mean(clear)[line]) ** 2)
    u, v = (forks.away[cells] - middle[line]).T
    angle = 0.5 * np.arctan2(2 * mean(u * v), mean(u * u) - mean(v * v))
    angle += np.pi * (np.cos(angle) * middle[:, 0] + np.sin(angle) * middle[:, 1] < 0)
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    s, c = -normal[line, 0], normal[line, 1]
    readings = np.minimum(count, AXIS_M / APART_M)
    bend = _bend(mean, (c * u + s * v, c * v - s * u), readings, (rounding, wide))
    unlike = 0.5 * (np.maximum(bend.left, 0.0) + wide) / rounding
    # Beyond three sigma it is none; exp would overflow.
    fits = unlike < 0.5 * 3**2
    of_mean = np.exp(np.where(fits, unlike, 0.0)) * rounding / count
    bearings[lines[fits]] = angle[fits]
    fork = lines // (len(forks.ring) // len(forks.xy))
    middle += forks.xy[fork]
    # All cells of an axis along the grid are rounded alike.
    variances = (rounding + of_mean)[fits], (of_mean / bend.spread)[fits]
    kept = _Bend(*(column[fits] for column in bend))
    axes = _Axes(fork[fits], middle[fits], normal[fits], *variances, kept)
    return bearings.reshape(len(forks.xy), -1), axes


def _bend(
    mean: Callable[[FloatArray], FloatArray],
    cells: tuple[FloatArray, FloatArray],
    readings: FloatArray,
    noise: tuple[float, FloatArray],
) -> _Bend:
    """The bends of axes, from their cells (c,) along and across the best-fitting straight lines
    [m].

    mean: over the cells of each axis; readings: (a,) number of independent cells; noise: variances
    [m²] of rounding, and (a,) of the corridor's width: objects in the corridor are not a bend. An
    axis is straight or, as likely, bends by a normal number of sigma BENT_PER_M.
    """
    along, across = cells
    rounding, wide = noise
    square = along * along
    spread = mean(square)
    skew = mean(square * along) / spread
    # Variance of s² that a straight line does not explain.
    unexplained = np.maximum(mean(square * square) - spread * spread - skew * skew * spread, 1e-9)
    shown, strays = mean(square * across), mean(across * across)
    weight = readings / np.maximum(rounding, strays - shown * shown / unexplained + wide)
    if_bent = 1 / (weight * unexplained + BENT_PER_M**-2)
    by = if_bent * weight * shown
    odds = 0.5 * (by * by / if_bent + np.log(if_bent / BENT_PER_M**2))
    likely = expit(odds)
    bent = likely * by
    left = strays - (2 * shown - bent * unexplained) * bent
    return _Bend(spread, skew, bent, likely * (if_bent + (1 - likely) * by * by), left)


def _centres(forks: _Forks, bearings: FloatArray, axes: _Axes) -> tuple[FloatArray, list[float]]:
    """(n, 2) maximum-likelihood centres of junctions from their axes and forks, at most one
    clearance from the fork, or at it with fewer than two axes; (n,) 1 sigma per coordinate [m].

    Forks deviate more than expected at rounded corners and niches. They get a Cauchy kernel, so
    that axes which agree on another point win. bearings: (n, b) of the branches [rad].
    """
    n = len(forks.xy)

    def total(values: FloatArray) -> FloatArray:
        """Sums over the axes of each fork."""
        out = np.zeros((n, *values.shape[1:]))
        np.add.at(out, axes.fork, values)
        return out

    fork_covariance = aside(bearings) * forks.clearance_m[:, None, None] ** 2
    fork_information = np.linalg.inv(fork_covariance)
    normal, bend, kernel = axes.normal, axes.bend, np.ones(n)
    xy = forks.xy
    on_axis, outer = np.sum(normal * axes.middle, axis=1), normal[:, :, None] * normal[:, None]
    for _ in range(3):
        # The variance of an axis grows with the distance from the middle of its cells.
        off = xy[axes.fork] - axes.middle
        along = off[:, 0] * normal[:, 1] - off[:, 1] * normal[:, 0]
        bow = along * along - bend.spread - bend.skew * along
        weight = 1 / (
            axes.variance + axes.turn_variance * along * along + bend.variance * bow * bow
        )
        prior = kernel[:, None, None] * fork_information
        information = prior + total(weight[:, None, None] * outer)
        rhs = prior @ forks.xy[:, :, None]
        rhs[:, :, 0] += total((weight * (on_axis + bend.bent * bow))[:, None] * normal)
        xy = np.asarray(np.linalg.solve(information, rhs)[:, :, 0], np.float64)
        moved = xy - forks.xy
        kernel = 1 / (1 + np.einsum("ni,nij,nj->n", moved, fork_information, moved))
    far = np.maximum(np.hypot(*moved.T) / forks.clearance_m, 1.0)
    crossed = np.bincount(axes.fork, minlength=n) >= 2
    covariance = np.where(crossed[:, None, None], np.linalg.inv(information), fork_covariance)
    sigma_m = np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2))
    return forks.xy + np.where(crossed, 1 / far, 0.0)[:, None] * moved, sigma_m.tolist()


def aside(bearings: FloatArray) -> FloatArray:
    """(n, 2, 2) covariances of the offsets of forks with branches at `bearings` (n, b) from where
    the axes cross, in squared clearances.

    For a corridor of half width h and one of equal width that leaves it at an angle a, the disc
    that touches the far wall and both corners lies h cot a along and h / (4 sin² a) aside, and its
    radius exceeds h by the latter. Because corridors bend, h cot a counts in every direction. Where
    two corridors cross, the fork is at their centre.
    """
    n, degree = bearings.shape
    least = np.broadcast_to(FORK_SHARE**2 * np.eye(2), (n, 2, 2))
    if degree != 3:
        return least
    turned = np.sort(bearings, axis=1)
    # The two that are most nearly opposite are the corridor that the third one leaves.
    third = np.argmax(np.abs(wrap(turned - np.roll(turned, 1, axis=1))), axis=1) + 1
    leaves, *corridor = np.take_along_axis(turned, (third[:, None] + np.arange(3)) % 3, axis=1).T
    a = np.clip(np.abs(wrap(leaves - np.array(corridor))).min(axis=0), *ANGLES_RAD)
    towards = _towards(a)
    # Both ends are used: which one sorts first is arbitrary where one points along the grid.
    s, c = (of(corridor[0]) - of(corridor[1]) for of in (np.sin, np.cos))
    across = np.stack([-s, c], axis=1) / np.hypot(s, c)[:, None]
    along, beside = np.tan(a) ** -2.0, towards**2
    spread = along[:, None, None] * np.eye(2)
    spread += beside[:, None, None] * across[:, :, None] * across[:, None]
    return np.asarray(least + spread / ((1 + towards) ** 2)[:, None, None])


def _towards(angle: FloatArray) -> FloatArray:
    """Radius of the disc at a fork minus that of its corridors, in half widths."""
    return np.asarray(0.25 / np.sin(angle) ** 2)


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
