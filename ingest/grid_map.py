"""The map of an occupancy grid: junctions and corridors of its free space, without a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.connected import connected
from ..topology.errors import DataError
from ..topology.polyline import simplify, way_of
from ..topology.ragged import Ragged
from ..topology.run import Grid
from ..topology.se2 import apply, compose, wrap
from ..topology.topomap import RunNoise, TopoMap
from .coarse_grid import affordable
from .grid_log import GridLog
from .logs.messages import several_that
from .scans.floorplan import Corridor, FloorplanSettings, Place, skeleton_graph
from .scans.views import grid_views

SMOOTH_M = 0.5
"""Length over which the staircase steps of skeletons are smoothed; corridors are straight over
it."""

PATH_TOLERANCE_M = 0.08
"""Tolerance of simplified paths, as for the corridors of runs (`mapbuilding`)."""

GRID_NOISE = RunNoise(
    centre_m=0.1, branch_rad=0.07, miss_rate=0.05, phantom_rate=0.03, branch_fault_rate=0.1
)
"""Of places found in skeletons, as measured on passes of real buildings: centres repeat within 0.08
to 0.18 m, branches within 4 degrees, one place in ten with another number of branches. The accuracy
of the grid itself is unknown: the defaults of odometry are used."""


FLOORPLAN = FloorplanSettings()


def map_of_grid(log: GridLog) -> TopoMap:
    """The topological map of the largest connected component of a grid's free space.

    It has no observations, and corridors without traversals. Raises DataError if there is no
    junction. O(cells).
    """
    grid, open_, coarser = affordable(_cropped(log.grid), FLOORPLAN.island_m)
    warnings = (*log.warnings, *coarser)
    frontier = grid.free & grid.unknown
    places, corridors = skeleton_graph(open_, grid.resolution_m, FLOORPLAN, frontier)
    if not any(place.kind == "junction" for place in places):
        raise DataError(
            f"run {log.name}: the grid of {grid.free.shape[1]} x {grid.free.shape[0]} cells, "
            f"{int(grid.free.sum())} of them free, shows no junction; "
            + "; ".join((*coarser, "nothing can be mapped"))
        )
    kept, used, left_out = _largest(places, corridors)
    if left_out:
        apart = several_that(left_out, "junction", "lie apart from the largest part of the grid")
        warnings += (f"{apart}; left out",)
    number = {old: new for new, old in enumerate(kept)}
    rows = [_branches(places[k], grid) for k in kept]
    branches = Ragged.from_rows([sorted_ for sorted_, _ in rows])
    place_of_branch = {old: order for old, (_, order) in zip(kept, rows, strict=True)}
    paths = [_path(c, places, grid) for c in used]
    length = np.array([way_of(path)[-1] for path in paths], np.float64)
    xy = apply(np.array(grid.origin), np.array([places[k].xy for k in kept]))
    return TopoMap(
        run=log.name,
        frame=grid.frame,
        xy=xy,
        branches=branches,
        kind=tuple(places[k].kind for k in kept),
        source=np.array([number[c.source] for c in used], np.int64),
        target=np.array([number[c.target] for c in used], np.int64),
        source_branch=_slots([(c.source, c.source_branch) for c in used], place_of_branch),
        target_branch=_slots([(c.target, c.target_branch) for c in used], place_of_branch),
        length=length,
        length_sigma=np.sqrt(2 * GRID_NOISE.centre_m**2 + (GRID_NOISE.scale * length) ** 2),
        traversals=np.zeros(len(used), np.int64),
        paths=tuple(simplify(path, PATH_TOLERANCE_M) for path in paths),
        observation_vertex=np.zeros(0, np.int64),
        observation_time_ns=np.zeros(0, np.int64),
        noise=GRID_NOISE,
        confidence=np.array([places[k].confidence for k in kept]),
        shows_bends=False,
        views=grid_views(log.grid, np.concatenate([xy, *paths])),
        info={
            "source": dict(log.source),
            "settings": asdict(FLOORPLAN),
            "warnings": list(warnings),
        },
    )


def _cropped(grid: Grid) -> Grid:
    """The grid without the rows and columns around its free space."""
    rows, columns = (_span(np.asarray(grid.free.any(axis=axis))) for axis in (1, 0))
    if rows.stop == 0:
        return grid._replace(free=grid.free[:1, :1], unknown=grid.unknown[:1, :1])
    corner = grid.resolution_m * np.array([columns.start, rows.start, 0.0])
    x, y, yaw = compose(np.array(grid.origin), corner).tolist()
    # Beyond the grid nothing is known.
    edged = np.pad(grid.unknown, 1, constant_values=True)
    edged = edged[rows.start : rows.stop + 2, columns.start : columns.stop + 2]
    rim = edged[1:-1, 1:-1] | edged[:-2, 1:-1] | edged[2:, 1:-1]
    rim |= edged[1:-1, :-2] | edged[1:-1, 2:]
    return grid._replace(free=grid.free[rows, columns], unknown=rim, origin=(x, y, yaw))


def _span(mask: BoolArray) -> slice:
    """From the first to the last marked element; empty if there are none."""
    if not mask.any():
        return slice(0, 0)
    return slice(int(mask.argmax()), len(mask) - int(mask[::-1].argmax()))


def _largest(
    places: tuple[Place, ...], corridors: tuple[Corridor, ...]
) -> tuple[list[int], list[Corridor], int]:
    """Places and corridors of the component with the longest corridors; number of junctions of the
    others."""
    ends = np.array([(c.source, c.target) for c in corridors], np.int64).reshape(-1, 2)
    if len(ends) == 0:
        return [0], [], len(places) - 1
    part = connected(ends[:, 0], ends[:, 1], len(places))
    weight = np.zeros(int(part.max()) + 1)
    np.add.at(weight, part[ends[:, 0]], [len(c.path) for c in corridors])
    best = int(weight.argmax())
    kept = np.flatnonzero(part == best).tolist()
    others = sum(p.kind == "junction" for p, q in zip(places, part, strict=True) if q != best)
    return kept, [c for c in corridors if part[c.source] == best], others


def _branches(place: Place, grid: Grid) -> tuple[FloatArray, IntArray]:
    """Headings in the map's frame, ascending, and the new index of each branch."""
    heading = np.asarray(wrap(place.branches + grid.origin[2]))
    order = np.argsort(heading, kind="stable")
    return heading[order], np.argsort(order, kind="stable")


def _slots(ends: list[tuple[int, int]], place_of_branch: Mapping[int, IntArray]) -> IntArray:
    return np.array([place_of_branch[place][branch] for place, branch in ends], np.int64)


def _path(corridor: Corridor, places: tuple[Place, ...], grid: Grid) -> FloatArray:
    """A corridor from place to place, in the map's frame, with the steps of its cells smoothed."""
    cells = max(1, round(SMOOTH_M / grid.resolution_m))
    path = uniform_filter1d(corridor.path, cells, axis=0, mode="nearest")
    path = np.concatenate(
        [places[corridor.source].xy[None], path, places[corridor.target].xy[None]]
    )
    step = np.hypot(*np.diff(path, axis=0).T)
    path = path[np.concatenate([[True], step > 1e-9])]
    if len(path) < 2:
        path = np.array([path[0], path[0] + [grid.resolution_m, 0.0]])
    return apply(np.array(grid.origin), path)
