"""The skeleton of free space as a graph: places with their branches, and corridors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from heapq import heappop, heappush

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from .skeleton_lines import Lines


@dataclass(frozen=True, slots=True)
class SkeletonSettings:
    """What of a skeleton is a corridor, and what a corner of a room."""

    clearance_m: float = 0.25
    """Free space narrower than twice this is no way: half the width of a small robot."""
    spur_m: float = 1.5
    spur_beyond_m: float = 0.5
    """Branches that end within this, or within the place's clearance and this, are corners."""
    join_m: float = 1.0
    """Places nearer to each other along the skeleton are one: the skeleton of a crossing is two
    forks beside each other."""
    chord_m: float = 1.5
    chord_beyond_m: float = 0.3
    """Where a branch's heading is taken: this far from the place, out of its widening."""

    def with_spurs(self, factor: float) -> SkeletonSettings:
        """The same with spurs of `factor` times the length pruned."""
        return replace(self, spur_m=factor * self.spur_m, spur_beyond_m=factor * self.spur_beyond_m)


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A fork of a skeleton. xy: (2,) x, y [m] from the middle of the first cell; clearance_m: from
    the nearest wall; ends: (b,) the edge of each branch, a ring's twice; sigma_m: 1 sigma of each
    coordinate of where its ways cross, NaN before that is known."""

    xy: FloatArray
    clearance_m: float
    ends: tuple[int, ...]
    sigma_m: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonGraph:
    """Places and the ways between them. pixels: of the skeleton that is left, row and column."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    pixels: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """A way of the skeleton. nodes: at its ends, -1 for none (a dead end, or the border); cells:
    (k, 2) row and column, in no order; length_m: along it."""

    nodes: tuple[int, int]
    cells: IntArray
    length_m: float

    def away(self, xy: FloatArray, cell_m: float) -> FloatArray:
        """(k, 2) where its cells lie from a point of the grid [m]."""
        return self.cells[:, ::-1] * cell_m - xy


@dataclass(slots=True, eq=False)
class _Segment:
    """A piece of skeleton while the graph is being simplified."""

    parts: list[int]
    nodes: list[int]
    length: float
    border: bool


@dataclass(slots=True, eq=False)
class _Net:
    """Nodes (centre, pixels) and segments by number."""

    centre: dict[int, FloatArray]
    clearance: dict[int, float]
    weight: dict[int, float]
    segments: dict[int, _Segment]
    incident: dict[int, list[int]] = field(default_factory=dict)
    """Segment numbers by node, twice for a loop."""
    joints: dict[int, list[int]] = field(default_factory=dict)
    """Segments swallowed by a node when others were joined to it."""
    changed: list[int] = field(default_factory=list)
    """Segments that are no longer what they were when they were last looked at."""


def thin(free: BoolArray) -> BoolArray:
    """The skeleton of a mask: one cell wide, as connected as the mask."""
    from skimage.morphology import skeletonize

    lines: BoolArray = skeletonize(free)  # type: ignore[no-untyped-call]
    return lines


def traced(lines: Lines, settings: SkeletonSettings = SkeletonSettings()) -> SkeletonGraph:
    """The places and ways of a skeleton.

    Spurs are pruned shortest first, places of two branches dissolved, near ones joined. Labels of
    pixels are made at once for all of the image; what is simplified is a graph of a few nodes.
    """
    net = _net(lines)
    _simplify(net, settings)
    return _graph(net, lines)


def _net(lines: Lines) -> _Net:
    segments = {
        k: _Segment([k], [], length, k in lines.border)
        for k, length in enumerate(lines.length_m.tolist())
        if k > 0
    }
    for line, fork in lines.touching:
        # A ring hangs on its one fork by both ends; a fork's own two pixels are no ring.
        segments[line].nodes.append(fork)
    numbers = range(1, len(lines.fork_xy))
    clearance, weight = lines.fork_clearance_m.tolist(), lines.fork_cells.tolist()
    net = _Net(
        {k: lines.fork_xy[k] for k in numbers},
        {k: clearance[k] for k in numbers},
        {k: weight[k] for k in numbers},
        segments,
    )
    net.incident = {k: [] for k in net.centre}
    net.joints = {k: [] for k in net.centre}
    for k, segment in segments.items():
        del segment.nodes[2:]
        for node in segment.nodes:
            net.incident[node].append(k)
    return net


def _simplify(net: _Net, settings: SkeletonSettings) -> None:
    """Prune spurs, dissolve places of two branches, join near ones, until nothing changes.

    Spurs go before places are joined, the shortest first. What may be next stands in heaps, by
    length; entries that changed since are passed over. O(n log n).
    """
    spurs: list[tuple[float, int]] = []
    joints: list[tuple[float, int]] = []
    net.changed = list(net.segments)
    while True:
        for k in net.changed:
            if _is_spur(net, k, settings):
                heappush(spurs, (net.segments[k].length, k))
            elif (rank := _joint_rank(net, k, settings)) is not None:
                heappush(joints, rank)
        net.changed.clear()
        if not (_prune(net, spurs, settings) or _join(net, joints, settings)):
            return


def _is_spur(net: _Net, k: int, settings: SkeletonSettings) -> bool:
    """Whether segment k is a corner of the free space, and no way."""
    segment = net.segments.get(k)
    if segment is None or len(segment.nodes) != 1 or segment.border:
        return False
    clear = net.clearance[segment.nodes[0]]
    return segment.length < max(settings.spur_m, clear + settings.spur_beyond_m)


def _joint_rank(net: _Net, k: int, settings: SkeletonSettings) -> tuple[float, int] | None:
    """When segment k is taken for part of one place; None if it is longer. Rings come first."""
    segment = net.segments.get(k)
    if segment is None or len(segment.nodes) != 2 or segment.length >= settings.join_m:
        return None
    return (segment.length, k) if segment.nodes[0] != segment.nodes[1] else (-1.0, -k)


def _prune(net: _Net, spurs: list[tuple[float, int]], settings: SkeletonSettings) -> bool:
    """Remove the shortest spur; False if there is none."""
    while spurs:
        length, at = heappop(spurs)
        if _is_spur(net, at, settings) and net.segments[at].length == length:
            break
    else:
        return False
    node = net.segments.pop(at).nodes[0]
    net.incident[node].remove(at)
    _dissolve(net, node)
    return True


def _join(net: _Net, joints: list[tuple[float, int]], settings: SkeletonSettings) -> bool:
    """Make one place of the two nearest; False if none are near."""
    while joints:
        rank = heappop(joints)
        at = abs(rank[1])
        if _joint_rank(net, at, settings) == rank:
            break
    else:
        return False
    segment = net.segments.pop(at)
    a, b = segment.nodes
    for node in (a, b):
        net.incident[node].remove(at)
    net.joints[a] += segment.parts
    if a != b:
        total = net.weight[a] + net.weight[b]
        net.centre[a] = (net.centre[a] * net.weight[a] + net.centre[b] * net.weight[b]) / total
        net.weight[a] = total
        net.clearance[a] = max(net.clearance[a], net.clearance.pop(b))
        for other in net.incident.pop(b):
            net.segments[other].nodes = [a if n == b else n for n in net.segments[other].nodes]
            net.incident[a].append(other)
        net.joints[a] += net.joints.pop(b)
        del net.centre[b], net.weight[b]
    net.changed += net.incident[a]
    _dissolve(net, a)
    return True


def _dissolve(net: _Net, node: int) -> None:
    """Let a place of fewer than three branches be part of the way through it."""
    ends = net.incident[node]
    if len(ends) >= 3:
        return
    net.changed += ends
    extra = net.joints[node]
    if len(ends) == 2 and ends[0] != ends[1]:
        first, second = (net.segments[k] for k in ends)
        others = [n for n in second.nodes if n != node]
        first.nodes = [n for n in first.nodes if n != node] + others
        first.parts += second.parts + extra
        first.length += second.length
        first.border |= second.border
        for other in others:
            net.incident[other] = [ends[0] if k == ends[1] else k for k in net.incident[other]]
        del net.segments[ends[1]]
    else:
        for k in set(ends):
            net.segments[k].nodes = [n for n in net.segments[k].nodes if n != node]
            net.segments[k].parts += extra
    for table in (net.centre, net.clearance, net.weight, net.incident, net.joints):
        table.pop(node, None)


def _graph(net: _Net, lines: Lines) -> SkeletonGraph:
    """What is left, with the cells of every way."""
    home = np.zeros(len(lines.length_m), np.int64)
    kept = sorted(net.segments)
    for number, k in enumerate(kept, start=1):
        home[net.segments[k].parts] = number
    owner = home[lines.line]
    left = np.flatnonzero(owner > 0)
    order = left[np.argsort(owner[left], kind="stable")]
    cells = lines.cells[order]
    bounds = np.searchsorted(owner[order], np.arange(1, len(kept) + 2))
    names = {node: index for index, node in enumerate(sorted(net.centre))}
    edges = []
    for number, k in enumerate(kept):
        segment = net.segments[k]
        ends = [names[n] for n in segment.nodes] + [-1, -1]
        own = cells[bounds[number] : bounds[number + 1]]
        edges.append(Edge((ends[0], ends[1]), own, segment.length))
    place = {k: number for number, k in enumerate(kept)}
    nodes = [
        Node(net.centre[n], net.clearance[n], tuple(place[k] for k in net.incident[n]))
        for n in names
    ]
    return SkeletonGraph(tuple(nodes), tuple(edges), cells)
