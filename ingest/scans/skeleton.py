"""The skeleton of free space as a graph of junctions and corridors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from .grid import Labels
from .skeleton_lines import Lines


@dataclass(frozen=True, slots=True)
class SkeletonSettings:
    """What is a corridor, and what a corner of a room."""

    clearance_m: float = 0.25
    """Half the width of the narrowest corridor: half the width of a small robot."""
    spur_m: float = 0.4
    """Branches that end are corners if they show less corridor than this (`Reach`). At 0.4, 0.6 and
    1.0 the junctions of a real building come back with the same branches in .93, .91 and .86 of
    passes."""
    taper: float = 0.5
    """Clearance lost per way towards the tip that is no corridor any more: that of a corner of 60
    degrees; right angles lose 0.71."""
    border_m: float = 0.0
    """The same of branches that run into the border: by default none is a corner."""
    join_m: float = 1.0
    """Nodes nearer to each other along the skeleton are merged: a crossing appears as two adjacent
    forks."""
    axes_m: float = float("inf")
    """Forks with more clearance stay where they are: a hall has no axes that cross."""
    chord_m: float = 1.5
    chord_beyond_m: float = 0.3
    """A branch's heading is measured at a distance of `chord_m`, or of the node's clearance plus
    this."""

    @property
    def variants(self) -> tuple[SkeletonSettings, ...]:
        """Four variations, each in one parameter."""
        return (
            replace(self, clearance_m=0.8 * self.clearance_m),
            replace(self, clearance_m=1.3 * self.clearance_m),
            replace(self, spur_m=0.8 * self.spur_m),
            replace(self, spur_m=1.25 * self.spur_m),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A fork of a skeleton, or a junction at the crossing of its axes (`crossing.py`).

    xy: (2,) from the centre of the first cell [m]; clearance_m: distance of the nearest wall; ends:
    (b,) the edge of each branch, a ring's twice; sigma_m: 1 sigma of each coordinate of the
    crossing, NaN if unknown; headings: (b,) [rad] of the branches of a junction, ascending, in the
    order of `ends`; bends: (b,) change of heading further on, if asked for.
    """

    xy: FloatArray
    clearance_m: float
    ends: tuple[int, ...]
    sigma_m: float = float("nan")
    headings: FloatArray = field(default_factory=lambda: np.zeros(0))
    bends: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonGraph:
    """Nodes and the edges between them; clearance_m: (h, w) distance of all cells from walls;
    cell_m: size of a cell."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    clearance_m: Float32Array | FloatArray
    cell_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """A line of the skeleton. nodes: at its ends, -1 for none (a dead end, or the border); cells:
    (k, 2) row and column, from the first node to the other; length_m: along it."""

    nodes: tuple[int, int]
    cells: IntArray
    length_m: float

    def away(self, xy: FloatArray, cell_m: float) -> FloatArray:
        """(k, 2) offsets of its cells from a point of the grid [m]."""
        return self.cells[:, ::-1] * cell_m - xy


HALF_M = 0.6
"""Half the width up to which corridors count by their length: wider ones count by how much longer
than wide they are, so that no part of a room is a corridor."""


class Reach(NamedTuple):
    """How much of a line is a corridor, walking along it in one direction.

    With s the way walked [m], r the clearance and t the taper of the settings, f = s - r / t rises
    along corridors and falls along the bisector of a corner, whose clearance grows with the way.
    Steps where r exceeds `HALF_M` count HALF_M / r. `most` is the largest rise of f between two
    points of the line: the length of a corridor of constant width, more beyond a door, next to
    nothing for a corner of any size. Like the erosion thickness (Liu, Chambers, Letscher and Ju,
    Extended grassfire transform on medial axes of 2D shapes, 2011), which counts corners by their
    size, it changes little when walls do.

    total: rise from end to end; first, last: largest rise from the beginning, and up to the end.
    """

    total: float
    first: float
    last: float
    most: float

    def then(self, other: Reach) -> Reach:
        """Of this line and another one that goes on where it ends."""
        return Reach(
            self.total + other.total,
            max(self.first, self.total + other.first),
            max(other.last, other.total + self.last),
            max(self.most, other.most, self.last + other.first),
        )


@dataclass(slots=True, eq=False)
class _Segment:
    """A line of the skeleton while the graph is being simplified. parts: numbers of its lines in
    order, negative where they are passed backwards; ends: the forks that it leads from and to, 0
    for none; along, back: its reach in this direction, and in the other one."""

    parts: list[int]
    ends: tuple[int, int]
    length: float
    border: bool
    along: Reach
    back: Reach

    @property
    def forks(self) -> list[int]:
        """The forks at its ends."""
        return [fork for fork in self.ends if fork]

    @property
    def corridor(self) -> float:
        """How much corridor it shows from its tip to its one fork [m]."""
        return (self.along if self.ends[1] else self.back).most

    def reversed(self) -> _Segment:
        """The same, in the other direction."""
        ends, parts = (self.ends[1], self.ends[0]), [-k for k in reversed(self.parts)]
        return replace(self, parts=parts, ends=ends, along=self.back, back=self.along)

    def lead(self, fork: int, to: int) -> None:
        """Let its ends at a fork be at another one, or at none (0)."""
        first, last = self.ends
        self.ends = (to if first == fork else first, to if last == fork else last)


@dataclass(slots=True, eq=False)
class _Fork:
    """A fork while the graph is being simplified: number of cells (weight), and segments, a loop
    twice."""

    centre: FloatArray
    clearance: float
    weight: float
    segments: list[int] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class _Net:
    """Forks and segments by number; changed: segments changed since they were last examined."""

    forks: dict[int, _Fork]
    segments: dict[int, _Segment]
    changed: list[int] = field(default_factory=list)


def thin(free: BoolArray) -> BoolArray:
    """The skeleton of a mask: one cell wide, with the same connectivity."""
    from skimage.morphology import skeletonize

    lines: BoolArray = skeletonize(free)  # type: ignore[no-untyped-call]
    return lines


def traced(lines: Lines, settings: SkeletonSettings = SkeletonSettings()) -> SkeletonGraph:
    """The graph of a skeleton.

    Spurs are pruned shortest first, nodes with two branches dissolved, near ones merged.
    """
    net = _net(lines, settings)
    _simplify(net, settings)
    return _graph(net, lines)


def _net(lines: Lines, settings: SkeletonSettings) -> _Net:
    reaches = _reaches(lines, settings.taper)
    ends = lines.ends.tolist()
    segments = {
        k: _Segment([k], (ends[k][0], ends[k][1]), length, k in lines.border, *reaches[k])
        for k, length in enumerate(lines.length_m.tolist())
        if k > 0
    }
    about = lines.fork_xy, lines.fork_clearance_m.tolist(), lines.fork_cells.tolist()
    forks = {k: _Fork(*each) for k, each in enumerate(zip(*about, strict=True)) if k > 0}
    for k, segment in segments.items():
        # A ring hangs on its one fork by both ends.
        for fork in segment.forks:
            forks[fork].segments.append(k)
    net = _Net(forks, segments)
    for fork in list(forks):
        _dissolve(net, fork)
    return net


def _reaches(lines: Lines, taper: float) -> list[tuple[Reach, Reach]]:
    """Of every line along its cells, and back; forks are points at their ends. O(c)."""
    count = len(lines.length_m)
    fork = lines.ends[1:].ravel()
    ends = np.searchsorted(lines.line, np.arange(1, count + 1)).repeat(2)[1:-1]
    at, number = (each[fork > 0] for each in (ends, np.arange(1, count).repeat(2)))
    fork = fork[fork > 0]
    owner = np.insert(lines.line, at, number)
    r = lines.clearance_m[tuple(lines.cells.T)].astype(np.float64)
    r = np.insert(r, at, lines.fork_clearance_m[fork])
    xy = np.insert(lines.cells[:, ::-1] * lines.cell_m, at, lines.fork_xy[fork], axis=0)
    step = np.zeros(len(xy))
    step[1:] = np.where(np.diff(owner) == 0, np.hypot(*np.diff(xy, axis=0).T), 0.0)
    wide = np.maximum(1.0, r / HALF_M)
    fall = np.diff(r, prepend=0.0) / taper
    fall[step == 0] = 0
    up, down = ((step * k - fall) / wide for k in (1, -1))
    out = []
    for side in (_rises(np.cumsum(up), owner), _rises(np.cumsum(down)[::-1], owner[::-1])):
        out.append([_NONE] * count)
        for k, row in side.items():
            out[-1][k] = row
    return list(zip(*out, strict=True))


_NONE = Reach(0.0, 0.0, 0.0, 0.0)


def _rises(f: FloatArray, owner: Labels) -> dict[int, Reach]:
    """The reach of every line whose values stand one after another, by number."""
    if len(f) == 0:
        return {}
    first = np.flatnonzero(np.concatenate([[True], np.diff(owner) != 0]))
    last = np.append(first[1:], len(f)) - 1
    # Every line lies below all before it: the running least starts anew at each.
    rank = np.repeat(np.arange(len(first)), last - first + 1)
    low = f - rank * (2 * float(np.ptp(f)) + 1.0)
    most = np.maximum.reduceat(low - np.minimum.accumulate(low), first)
    total = f[last] - f[first]
    begun = np.maximum.reduceat(f, first) - f[first]
    ended = f[last] - np.minimum.reduceat(f, first)
    rows = zip(*(c.tolist() for c in (total, begun, ended, most)), strict=True)
    return {k: Reach(*row) for k, row in zip(owner[first].tolist(), rows, strict=True)}


def _simplify(net: _Net, settings: SkeletonSettings) -> None:
    """Prune spurs, dissolve forks with two branches, merge near ones, until nothing changes.

    Spurs go before forks are merged, the least first. Candidates are kept in a heap; outdated
    entries are skipped. O(n log n).
    """
    candidates: list[tuple[bool, float, int]] = []
    net.changed = list(net.segments)
    while True:
        for k in net.changed:
            if (rank := _rank(net, k, settings)) is not None:
                heappush(candidates, rank)
        net.changed.clear()
        if not candidates:
            return
        rank = heappop(candidates)
        at = abs(rank[-1])
        if _rank(net, at, settings) == rank:
            _remove(net, at)


def _rank(net: _Net, k: int, settings: SkeletonSettings) -> tuple[bool, float, int] | None:
    """Sort key of segment k among spurs (corners of the free space, by how much corridor they
    show), and then among those whose two ends are merged (rings first, then by length); None if it
    stays."""
    segment = net.segments.get(k)
    forks = segment.forks if segment is not None else []
    if segment is None or not forks:
        return None
    if len(forks) == 1:
        least = settings.border_m if segment.border else settings.spur_m
        return (False, segment.corridor, k) if segment.corridor < least else None
    if segment.length >= settings.join_m:
        return None
    return (True, segment.length, k) if forks[0] != forks[1] else (True, -1.0, -k)


def _remove(net: _Net, k: int) -> None:
    """Remove segment k, and merge the forks that it joins."""
    forks = net.segments.pop(k).forks
    for fork in forks:
        net.forks[fork].segments.remove(k)
    a, b = forks[0], forks[-1]
    if a != b:
        one, other = net.forks[a], net.forks.pop(b)
        total = one.weight + other.weight
        one.centre = (one.centre * one.weight + other.centre * other.weight) / total
        one.weight, one.clearance = total, max(one.clearance, other.clearance)
        for segment in other.segments:
            net.segments[segment].lead(b, a)
        one.segments += other.segments
    if len(forks) == 2:
        net.changed += net.forks[a].segments
    _dissolve(net, a)


def _dissolve(net: _Net, fork: int) -> None:
    """Remove a fork of fewer than three branches and join its segments."""
    ends = net.forks[fork].segments
    if len(ends) >= 3:
        return
    net.changed += ends
    if len(ends) == 2 and ends[0] != ends[1]:
        first, second = (net.segments[k] for k in ends)
        first = first if first.ends[1] == fork else first.reversed()
        second = second if second.ends[0] == fork else second.reversed()
        other = second.ends[1]
        net.segments[ends[0]] = _Segment(
            first.parts + second.parts,
            (first.ends[0], other),
            first.length + second.length,
            first.border or second.border,
            first.along.then(second.along),
            second.back.then(first.back),
        )
        if other:
            beyond = net.forks[other]
            beyond.segments = [ends[0] if k == ends[1] else k for k in beyond.segments]
        del net.segments[ends[1]]
    else:
        for k in ends:
            net.segments[k].lead(fork, 0)
    del net.forks[fork]


def _graph(net: _Net, lines: Lines) -> SkeletonGraph:
    """The remaining graph, with the cells of every edge in order."""
    bounds = np.searchsorted(lines.line, np.arange(1, len(lines.length_m) + 1)).tolist()

    def cells_of(part: int) -> IntArray:
        own = lines.cells[bounds[abs(part) - 1] : bounds[abs(part)]]
        return own if part > 0 else own[::-1]

    names = {node: index for index, node in enumerate(sorted(net.forks))}
    kept = sorted(net.segments)
    edges = []
    for k in kept:
        segment = net.segments[k]
        if segment.ends[0] == 0:
            segment = segment.reversed()
        cells = np.concatenate([cells_of(part) for part in segment.parts])
        ends = names.get(segment.ends[0], -1), names.get(segment.ends[1], -1)
        edges.append(Edge(ends, cells, segment.length))
    place = {k: number for number, k in enumerate(kept)}
    nodes = [
        Node(fork.centre, fork.clearance, tuple(place[k] for k in fork.segments))
        for fork in (net.forks[number] for number in names)
    ]
    return SkeletonGraph(tuple(nodes), tuple(edges), lines.clearance_m, lines.cell_m)
