"""The skeleton of free space as a graph of junctions and corridors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from heapq import heappop, heappush

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from .skeleton_lines import Lines


@dataclass(frozen=True, slots=True)
class SkeletonSettings:
    """What is a corridor, and what a corner of a room."""

    clearance_m: float = 0.25
    """Half the width of the narrowest corridor: half the width of a small robot."""
    spur_m: float = 1.5
    spur_beyond_m: float = 0.5
    """Branches that end within `spur_m`, or within the node's clearance plus this, are corners."""
    join_m: float = 1.0
    """Nodes nearer to each other along the skeleton are merged: a crossing appears as two adjacent
    forks."""
    chord_m: float = 1.5
    chord_beyond_m: float = 0.3
    """A branch's heading is measured at a distance of `chord_m`, or of the node's clearance plus
    this."""

    def with_spurs(self, factor: float) -> SkeletonSettings:
        """The same, with spurs of `factor` times the length pruned."""
        return replace(self, spur_m=factor * self.spur_m, spur_beyond_m=factor * self.spur_beyond_m)


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A fork of a skeleton.

    xy: (2,) from the centre of the first cell [m]; clearance_m: distance of the nearest wall; ends:
    (b,) the edge of each branch, a ring's twice; sigma_m: 1 sigma of each coordinate of the
    crossing of its axes, NaN if unknown.
    """

    xy: FloatArray
    clearance_m: float
    ends: tuple[int, ...]
    sigma_m: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonGraph:
    """Nodes and the edges between them. pixels: of the remaining skeleton, row and column."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    pixels: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """A line of the skeleton. nodes: at its ends, -1 for none (a dead end, or the border); cells:
    (k, 2) row and column, unordered; length_m: along it."""

    nodes: tuple[int, int]
    cells: IntArray
    length_m: float

    def away(self, xy: FloatArray, cell_m: float) -> FloatArray:
        """(k, 2) offsets of its cells from a point of the grid [m]."""
        return self.cells[:, ::-1] * cell_m - xy


@dataclass(slots=True, eq=False)
class _Segment:
    """A line of the skeleton while the graph is being simplified."""

    parts: list[int]
    nodes: list[int]
    length: float
    border: bool


@dataclass(slots=True, eq=False)
class _Net:
    """Nodes (centre, clearance, number of pixels) and segments by number."""

    centre: dict[int, FloatArray]
    clearance: dict[int, float]
    weight: dict[int, float]
    segments: dict[int, _Segment]
    incident: dict[int, list[int]] = field(default_factory=dict)
    """Segment numbers by node, twice for a loop."""
    joints: dict[int, list[int]] = field(default_factory=dict)
    """Segments absorbed by a node when nodes were merged."""
    changed: list[int] = field(default_factory=list)
    """Segments changed since they were last examined."""


def thin(free: BoolArray) -> BoolArray:
    """The skeleton of a mask: one cell wide, with the same connectivity."""
    from skimage.morphology import skeletonize

    lines: BoolArray = skeletonize(free)  # type: ignore[no-untyped-call]
    return lines


def traced(lines: Lines, settings: SkeletonSettings = SkeletonSettings()) -> SkeletonGraph:
    """The graph of a skeleton.

    Spurs are pruned shortest first, nodes with two branches dissolved, near ones merged.
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
    """Prune spurs, dissolve nodes with two branches, merge near ones, until nothing changes.

    Spurs go before nodes are merged, the shortest first. Candidates are kept in heaps by length;
    outdated entries are skipped. O(n log n).
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
    """Whether segment k is a corner of the free space."""
    segment = net.segments.get(k)
    if segment is None or len(segment.nodes) != 1 or segment.border:
        return False
    clear = net.clearance[segment.nodes[0]]
    return segment.length < max(settings.spur_m, clear + settings.spur_beyond_m)


def _joint_rank(net: _Net, k: int, settings: SkeletonSettings) -> tuple[float, int] | None:
    """Sort key of segment k among those whose two ends are merged, rings first; None if it is too
    long for that."""
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
    """Merge the two nearest nodes; False if none are near."""
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
    """Remove a node of fewer than three branches and join its segments."""
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
    """The remaining graph, with the cells of every edge."""
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
