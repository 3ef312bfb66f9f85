"""The map of an occupancy grid: junctions and corridors of its free space, without a trajectory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
from scipy.ndimage import binary_dilation, label

from ..topology.arrays import FloatArray, IntArray
from ..topology.connected import connected
from ..topology.errors import DataError
from ..topology.polyline import densely
from ..topology.ragged import Ragged
from ..topology.run import Grid
from ..topology.se2 import apply, compose, wrap
from ..topology.topomap import RunNoise, TopoMap
from ..topology.turning_points import FRONTIER, NO_TURNING_POINTS, TurningPoints
from ..topology.wording import counted
from .logs.grids import GridLog
from .logs.messages import several_that
from .logs.saved_map import coarser
from .scans.floorplan import (
    CELL_M,
    MOST_CELLS,
    Corridor,
    Floorplan,
    FloorplanSettings,
    Ground,
    Place,
    plan,
)
from .scans.open_space import distance
from .scans.views import grid_views, too_large

GRID_NOISE = RunNoise(
    centre_m=0.25, branch_rad=0.07, miss_rate=0.2, phantom_rate=0.15, branch_fault_rate=0.3
)
"""Of places found in skeletons of maps that were recorded at different times: doors and furniture
are part of such a map. Of 14 maps of one floor a third of the junctions of one lies within 0.3 m of
one in another, two thirds within 0.6 m, two thirds of these with as many branches. Of 97 pairs of
such maps 40 have enough evidence to be merged with these values, 37 with .15, .1, .2 and .2 m, 20
with those of one recording (.05, .03, .1, .1 m); of 113 other pairs the most is 5.6, 5.1, 5.4 bits.
Three maps of one office, of three dates, merge from .25 m on.
The accuracy of the grid itself is unknown: the defaults of odometry are used."""

FLOORPLAN = FloorplanSettings()


def map_of_grid(log: GridLog, settings: FloorplanSettings = FLOORPLAN) -> TopoMap:
    """The topological map of the largest connected component of a grid's free space.

    It has no observations, and corridors without traversals. Where small obstacles hide all
    junctions, they make junctions. Without any the widest place stands for one; raises DataError
    if there is no space for one. O(cells log cells).
    """
    grid, large = lattice(_cropped(log.grid))
    warnings = (*log.warnings, *large)
    tried, (places, corridors, blocked) = _best_plan(grid, settings)
    if not any(place.kind in ("junction", "room") for place in places):
        widest = _widest(grid)
        if widest is None:
            raise DataError(
                f"run {log.name}: the grid of {grid.free.shape[1]} x {grid.free.shape[0]} cells, "
                f"{int(grid.free.sum())} of them free, shows no junction and no room; "
                + "; ".join((*large, "nothing can be mapped"))
                + f" (with --robot-radius {settings.skeleton.clearance_m:g}: smaller robots fit "
                "through narrower doors)"
            )
        tried, places, corridors = settings, (widest,), ()
        warnings += (
            "no junction and no room behind a door shows in the grid: its widest place stands for "
            "one, and only the walls around can place the map in others",
        )
    elif tried.skeleton.clearance_m < settings.skeleton.clearance_m:
        warnings += (
            f"mapped for a robot of {tried.skeleton.clearance_m:g} m radius, which fits through "
            f"narrower doors; one of {settings.skeleton.clearance_m:g} m meets no junction",
        )
    if blocked:
        warnings += (f"{counted(blocked, 'corridor')} left out: a robot cannot drive there",)
    kept, used, left_out = _largest(places, corridors)
    if left_out:
        apart = several_that(left_out, "junction", "lie apart from the largest part of the grid")
        warnings += (f"{apart}; left out",)
    if too_large(log.grid):
        warnings += (
            "its area is large; no views of walls are kept, places are known by corridors",
        )
    vertices = [k for k in kept if places[k].kind != "frontier"]
    number = {old: new for new, old in enumerate(vertices)}
    rows = {k: _branches(places[k], grid) for k in kept}
    edges = [c for c in used if places[c.target].kind != "frontier"]
    length = np.array([c.length_m for c in edges])
    origin = np.array(grid.origin)
    xy = apply(origin, np.array([places[k].xy for k in vertices]))
    along = [apply(origin, densely(c.path, grid.resolution_m)) for c in used]
    return TopoMap(
        run=log.name,
        frame=grid.frame,
        xy=xy,
        branches=Ragged.from_rows([rows[k][0] for k in vertices]),
        kind=tuple(places[k].kind for k in vertices),
        source=np.array([number[c.source] for c in edges], np.int64),
        target=np.array([number[c.target] for c in edges], np.int64),
        source_branch=_slots([(c.source, c.source_branch) for c in edges], rows),
        target_branch=_slots([(c.target, c.target_branch) for c in edges], rows),
        length=length,
        length_sigma=_length_sigma(length),
        traversals=np.zeros(len(edges), np.int64),
        paths=tuple(apply(origin, c.path) for c in edges),
        observation_vertex=np.zeros(0, np.int64),
        observation_time_ns=np.zeros(0, np.int64),
        noise=GRID_NOISE,
        confidence=np.array([places[k].confidence for k in vertices]),
        shows_bends=False,
        area_m2=np.array([places[k].area_m2 or 0.0 for k in vertices]),
        width_m=np.array([places[k].width_m or 0.0 for k in vertices]),
        turning_points=_frontiers(
            [c for c in used if places[c.target].kind == "frontier"], number, rows, origin
        ),
        views=grid_views(log.grid, np.concatenate([xy, *along])),
        info={"source": dict(log.source), "settings": asdict(tried), "warnings": list(warnings)},
    )


def _best_plan(grid: Grid, settings: FloorplanSettings) -> tuple[FloorplanSettings, Floorplan]:
    """The plan with the most junctions and rooms, and its settings; the first with a junction
    ends the search. A room with pillars has junctions between these alone; the more rooms of a
    small home, the narrower the doors that a robot fits through."""
    frontier = grid.free & binary_dilation(grid.unknown)
    ground = Ground.of(grid.free, frontier, grid.resolution_m, settings.skeleton.clearance_m)
    most = -1
    for other in (settings, settings.among_pillars, settings.through_narrow_doors):
        found = plan(ground, other)
        kinds = [place.kind for place in found.places]
        count = kinds.count("junction") + kinds.count("room")
        if count > most:
            most, best = count, (other, found)
        if "junction" in kinds:
            break
    return best


LEAST_M2 = 20.0
"""Least free area of a map without a junction: a room, a tenth of a view."""


def _widest(grid: Grid) -> Place | None:
    """The widest place of the largest part of the free space, as a room; None if it is small."""
    parts, _ = label(grid.free)
    area_m2 = np.bincount(parts[grid.free], minlength=2) * grid.resolution_m**2
    part = int(area_m2.argmax())
    if area_m2[part] < LEAST_M2:
        return None
    away = distance(parts == part, grid.resolution_m)
    row, column = np.unravel_index(int(away.argmax()), away.shape)
    xy = (np.array([column, row]) + 0.5) * grid.resolution_m
    return Place(xy, np.zeros(0), "room", 1.0, area_m2=float(area_m2[part]))


def lattice(grid: Grid) -> tuple[Grid, list[str]]:
    """The grid in cells of about `CELL_M`, or in larger ones if there are too many: then with a
    warning.

    A larger cell is free if all its parts are: walls stay, corridors get narrower by at most a
    cell. O(cells).
    """
    factor = max(1, int(CELL_M / grid.resolution_m + 1e-6))
    # With a cell around: a grid in one row is three of them.
    while math.prod(2 - (-n // factor) for n in grid.free.shape) > MOST_CELLS:
        factor += 1
    found = coarser(grid, factor)
    if found.resolution_m <= CELL_M * (1 + 1e-6) or factor == 1:
        return found, []
    height, width = grid.free.shape
    large = f"the grid, {width} x {height} cells, is large"
    return found, [f"{large}; cells of {found.resolution_m:g} m are taken"]


_Rows = Mapping[int, tuple[FloatArray, IntArray]]
"""Headings of a place's branches in the map's frame, and the new index of each branch."""


def _frontiers(
    ways: Sequence[Corridor], number: Mapping[int, int], rows: _Rows, origin: FloatArray
) -> TurningPoints:
    """Where ways lead on into the unknown: no vertices that another map would know."""
    k = len(ways)
    if k == 0:
        return NO_TURNING_POINTS
    length = np.array([way.length_m for way in ways])
    return TurningPoints(
        kind=(FRONTIER,) * k,
        vertex=np.array([number[way.source] for way in ways], np.int64),
        branch=_slots([(way.source, way.source_branch) for way in ways], rows),
        heading=np.array([rows[way.target][0][0] for way in ways]),
        length=length,
        length_sigma=_length_sigma(length),
        position_sigma=np.full(k, GRID_NOISE.centre_m),
        branch_sigma=np.full(k, GRID_NOISE.branch_rad),
        traversals=np.zeros(k, np.int64),
        paths=tuple(apply(origin, way.path) for way in ways),
        traversal_ns=(np.zeros((0, 2), np.int64),) * k,
        time_ns=(np.zeros((0, 1), np.int64),) * k,
    )


def _length_sigma(length_m: FloatArray) -> FloatArray:
    """1 sigma [m] of the lengths of corridors."""
    return np.sqrt(2 * GRID_NOISE.centre_m**2 + (GRID_NOISE.scale * length_m) ** 2)


def _cropped(grid: Grid) -> Grid:
    """The grid without the rows and columns around its free space, but one on every side."""
    rows, columns = (np.flatnonzero(grid.free.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return grid._replace(free=grid.free[:1, :1], unknown=grid.unknown[:1, :1])
    corner = grid.resolution_m * np.array([columns[0] - 1.0, rows[0] - 1.0, 0.0])
    x, y, yaw = compose(np.array(grid.origin), corner).tolist()
    # Beyond the grid nothing is known.
    within = np.s_[rows[0] : rows[-1] + 3, columns[0] : columns[-1] + 3]
    free = np.pad(grid.free, 1)[within]
    unknown = np.pad(grid.unknown, 1, constant_values=True)[within]
    return grid._replace(free=free, unknown=unknown, origin=(x, y, yaw))


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


def _slots(ends: Sequence[tuple[int, int]], rows: _Rows) -> IntArray:
    """The new index of the branches by which corridors leave places."""
    return np.array([rows[place][1][branch] for place, branch in ends], np.int64)
