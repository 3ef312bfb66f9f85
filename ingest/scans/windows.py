"""Junctions seen from every part of the track: a grid around it, its skeleton, and its forks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import count, groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined, take
from ...topology.odometry import Odometry
from ...topology.track import piece_of, point_at, way_at
from ...topology.views import SIDE, view_cells
from .crossing import bends, crossing, crossings
from .grid import GridSettings, Looks, Window, free_space, gather, labelled, looks
from .matching import Matched, Placed
from .skeleton import Node, SkeletonSettings, thin, traced
from .skeleton_lines import Lines, lines_of


class Variant(NamedTuple):
    """One variant of the settings of a window."""

    grid: GridSettings
    skeleton: SkeletonSettings
    way_m: float


@dataclass(frozen=True, slots=True)
class WindowSettings:
    """Positions of windows and their contents."""

    grid: GridSettings = field(default_factory=GridSettings)
    skeleton: SkeletonSettings = field(default_factory=SkeletonSettings)
    way_m: float = 10.0
    """Distance before and after that a window is made of: short enough for little drift."""
    every_m: float = 1.5
    half_m: float = 6.0
    """Half the side of a window: the farthest node, and a spur beyond it."""
    near_m: float = 1.25
    """Largest distance at which a passed junction counts."""

    @property
    def variants(self) -> tuple[Variant, ...]:
        """The settings and six variations, each in one parameter."""
        g, s, way = self.grid, self.skeleton, self.way_m
        return (
            Variant(g, s, way),
            *(Variant(g, other, way) for other in s.variants),
            Variant(replace(g, wall_share=1.6 * g.wall_share), s, way),
            Variant(g, s, 0.75 * way),
        )


WINDOWS = WindowSettings()


MOST_HELD = 800
"""Keyframes held for later windows, 50 kB each."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The contents of one window: its position [m driven], forks (variant, distance driven,
    crossing), and the view (`topology.views`) from `place` (2,) [m]."""

    number: int
    way: float
    forks: tuple[tuple[int, float, Node], ...]
    place: FloatArray
    view: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class _Rolling(Looks):
    """Keyframes around the next window: what they saw, the robot's pose (k, 3), and the distance
    driven up to each (k,) [m]."""

    body: FloatArray
    way: FloatArray

    def at(self, way: FloatArray | float) -> FloatArray:
        """(…, 2) position of the robot after a distance."""
        return np.stack([np.interp(way, self.way, self.body[:, k]) for k in (0, 1)], axis=-1)


def windows(parts: Iterable[Matched]) -> Iterator[Seen]:
    """Evaluate a window at every `every_m` of the track, as the keyframes come in.

    Memory: the keyframes of two windows.
    """
    numbers, driven = count(), 0.0
    for _, runs in groupby(_unbroken(parts), key=lambda run: int(run.piece[0])):
        held: _Rolling | None = None
        following = driven
        for run in runs:
            held = _rolling(run, held, driven)
            ready = float(held.way[-1]) - WINDOWS.way_m
            for seen in _due(held, (following, ready), numbers):
                yield seen
                following = seen.way + WINDOWS.every_m
            held = _trimmed(held, following - WINDOWS.way_m)
        if held is not None:
            yield from _due(held, (following, np.inf), numbers)
            driven = float(held.way[-1])


def window_places(odometry: Odometry, time_ns: IntArray) -> FloatArray:
    """(k, 2) the places of the windows that the keyframes of these times are the next after, in the
    frame of the matched odometry [m], as `Seen.place` has them."""
    way, cell_m = way_at(odometry, time_ns), WINDOWS.grid.cell_m
    begin = way_at(odometry, odometry.time_ns[[0, *odometry.breaks]])
    first = begin[piece_of(odometry, time_ns)]
    # A keyframe may be at the window itself, within rounding.
    nth = np.floor((way - first) / WINDOWS.every_m + 1e-6)
    middle = point_at(odometry, first + nth * WINDOWS.every_m)
    return np.asarray(np.floor(middle / cell_m) * cell_m)


def _unbroken(parts: Iterable[Matched]) -> Iterator[Placed]:
    """The keyframes, cut at breaks of the odometry."""
    for frames, *_ in parts:
        cuts = (np.flatnonzero(np.diff(frames.piece)) + 1).tolist()
        for a, b in pairwise([0, *cuts, len(frames)]):
            if b > a:
                yield take(frames, slice(a, b))


def _rolling(run: Placed, held: _Rolling | None, driven: float) -> _Rolling:
    """The keyframes held, with more appended; driven: the distance before the first of all."""
    body, seen = run.body, looks(run, run.pose, WINDOWS.grid)
    before = held.body[-1:] if held is not None else body[:1]
    start = float(held.way[-1]) if held is not None else driven
    step = np.hypot(*np.diff(np.concatenate([before, body])[:, :2], axis=0).T)
    fresh = _Rolling(seen.free, seen.hit, seen.corner, body, start + np.cumsum(step))
    return fresh if held is None else joined([held, fresh])


def _trimmed(held: _Rolling, oldest: float) -> _Rolling:
    first = min(int(np.searchsorted(held.way, oldest)), len(held.way) - 1)
    # Rotation on the spot adds keyframes without distance: thin them out.
    every = 1 + (len(held.way) - first) // MOST_HELD
    return take(held, np.arange(len(held.way) - 1, first - 1, -every)[::-1])


def _due(held: _Rolling, stretch: tuple[float, float], numbers: Iterator[int]) -> Iterator[Seen]:
    """The windows whose centres lie within an interval of the distance held, from its start on."""
    (following, ready), last = stretch, float(held.way[-1])
    while following <= min(ready, last):
        yield _look(held, following, next(numbers))
        following += WINDOWS.every_m


def _look(held: _Rolling, middle: float, number: int) -> Seen:
    """One window under all variants of the settings."""
    cell_m = WINDOWS.grid.cell_m
    half = round(WINDOWS.half_m / cell_m)
    side = 2 * half + 1
    # A view shows more than a window, but is made of the same.
    around = _gathered(held, middle, WINDOWS.way_m, SIDE)
    corner = around.corner + SIDE - half
    path = _dense(held, middle - WINDOWS.every_m, middle + WINDOWS.every_m, cell_m)
    driven = np.floor(path / cell_m).astype(np.int64) - corner
    driven = driven[((driven >= 0) & (driven < side)).all(axis=1)]
    border = np.pad(np.zeros((side - 2, side - 2), bool), 1, constant_values=True)

    # Most variants differ in few settings, and share the rest.
    @cache
    def distance(grid: GridSettings, way_m: float) -> FloatArray:
        """(s, s) from the nearest wall [m]; the border is not a wall."""
        usual = way_m == WINDOWS.way_m
        seen = around.inner(SIDE - half) if usual else _gathered(held, middle, way_m, half)
        free = np.pad(free_space(seen, grid), 1, mode="edge")
        away = np.asarray(ndimage.distance_transform_edt(free), np.float64)
        return away[1:-1, 1:-1] * cell_m

    @cache
    def lines(grid: GridSettings, way_m: float, least_m: float) -> Lines:
        """The skeleton of the free space with a clearance that the robot drove through."""
        clearance_m = distance(grid, way_m)
        labels, count = labelled(clearance_m > least_m)
        mine = np.zeros(count + 1, bool)
        mine[labels[driven[:, 1], driven[:, 0]]] = True
        mine[0] = False
        return lines_of(thin(mine[labels]), clearance_m, cell_m, border)

    nearest = _Nearest.of(held, middle)
    origin = (corner + 0.5) * cell_m
    forks: list[tuple[int, float, Node]] = []
    for k, (grid, skeleton, way_m) in enumerate(WINDOWS.variants):
        graph = traced(lines(grid, way_m, skeleton.clearance_m), skeleton)
        nodes = [
            number
            for number, node in enumerate(graph.nodes)
            if len(node.ends) >= 3
            and nearest.way(node.xy + origin, WINDOWS.near_m + node.clearance_m) is not None
        ]
        places, _ = crossings(graph, nodes, skeleton)
        for place in places.values():
            xy = place.xy + origin
            way = nearest.way(xy, WINDOWS.near_m)
            if way is not None:
                fork = crossing(graph, place, skeleton)
                turn = bends(graph, fork, skeleton)
                forks.append((k, way, replace(fork, xy=xy, bends=turn)))
    # One cell less than a window has, which has a middle one.
    cells = view_cells(around.hit[:-1, :-1], around.free[:-1, :-1])
    corner_xy = np.asarray((around.corner + SIDE) * cell_m, np.float64)
    return Seen(number, middle, tuple(forks), corner_xy, cells)


def _gathered(held: _Rolling, middle: float, way_m: float, half: int) -> Window:
    """What was seen on the way before and after a position, within `half` cells of it."""
    begin, end = middle - way_m, middle + way_m
    a, b = np.searchsorted(held.way, [begin, end]).tolist()
    rows = range(a, min(max(b, a + 1), len(held.way)))
    path = _dense(held, begin, end, WINDOWS.grid.cell_m)
    return gather(held, rows, path, (held.at(middle), half), WINDOWS.grid)


def _dense(held: _Rolling, begin: float, end: float, step: float) -> FloatArray:
    """(w, 2) points of the track, closer than `step`."""
    begin, end = max(begin, float(held.way[0])), min(end, float(held.way[-1]))
    return held.at(np.linspace(begin, end, max(2, int((end - begin) / (0.7 * step)) + 2)))


class _Nearest(NamedTuple):
    """The track about the middle of a window: distances driven (w,) [m], and points (w, 2) [m]."""

    driven: FloatArray
    xy: FloatArray

    @classmethod
    def of(cls, held: _Rolling, middle: float) -> _Nearest:
        reach = 1.5 * WINDOWS.every_m
        begin, end = max(middle - reach, held.way[0]), min(middle + reach, held.way[-1])
        driven = np.linspace(begin, end, 64)
        return cls(driven, held.at(driven))

    def way(self, xy: FloatArray, near_m: float) -> float | None:
        """Distance driven when the robot was nearest to a place; None if it did not pass it."""
        distance = np.hypot(*(self.xy - xy).T)
        best = int(np.argmin(distance))
        return float(self.driven[best]) if distance[best] <= near_m else None
