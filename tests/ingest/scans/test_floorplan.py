"""Places and corridors of grids drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from topobatch.ingest.scans.grid import GridSettings, without_islands
from topobatch.topology.polyline import way_of
from topobatch.topology.se2 import wrap

from .plans import planned


def grid(*rooms: tuple[int, int, int, int], shape: tuple[int, int] = (200, 300)) -> np.ndarray:
    """Free cells where any rectangle (row, column, row, column) lies."""
    free = np.zeros(shape, bool)
    for a, b, c, d in rooms:
        free[a:c, b:d] = True
    return free


CROSS = grid((90, 20, 110, 280), (10, 140, 190, 160))
CELL = 0.1


def in_free_cells(path: np.ndarray, free: np.ndarray) -> bool:
    """Whether every point along a path lies in a free cell."""
    way = way_of(path)
    at = np.arange(0, way[-1], CELL / 4)
    columns, rows = (np.interp(at, way, path[:, k]) // CELL for k in (0, 1))
    return bool(free[rows.astype(int), columns.astype(int)].all())


def headings_off(branches: np.ndarray, wanted: list[float]) -> float:
    return float(np.abs(wrap(branches[:, None] - np.array(wanted))).min(axis=0).max())


def test_cross() -> None:
    places, corridors, _ = planned(CROSS, CELL)
    junctions = [p for p in places if p.kind == "junction"]
    assert len(junctions) == 1
    assert np.hypot(*(junctions[0].xy - (15.0, 10.0))) < 0.2
    assert headings_off(junctions[0].branches, [0, np.pi / 2, -np.pi, -np.pi / 2]) < 0.1
    assert junctions[0].confidence == 1.0
    assert len(places) == 5
    assert len(corridors) == 4
    for corridor in corridors:
        ends = places[corridor.source], places[corridor.target]
        for place, point in zip(ends, corridor.path[[0, -1]], strict=True):
            assert np.hypot(*(place.xy - point)) < 0.3
        assert in_free_cells(corridor.path, CROSS)
        leaving = corridor.path[1] - corridor.path[0]
        branch = ends[0].branches[corridor.source_branch]
        assert abs(wrap(np.arctan2(leaving[1], leaving[0]) - branch)) < 0.3


def test_pillars_corners_and_narrow_gaps_are_no_junctions() -> None:
    """A pillar, a gap of 0.3 m and a corner beside one side corridor, which makes the only one."""
    rooms = (80, 20, 120, 280), (120, 150, 190, 153), (10, 235, 80, 265), (120, 60, 190, 90)
    free = grid(*rooms)
    free[98:102, 150:154] = False
    places = planned(without_islands(free, GridSettings().island_m / CELL), CELL).places
    (junction,) = [p for p in places if p.kind == "junction"]
    assert np.hypot(*(junction.xy - (7.5, 10.0))) < 0.3
    assert headings_off(junction.branches, [0.0, np.pi / 2, np.pi]) < 0.1
    assert len(places) == 4


@pytest.mark.parametrize("slope", [0.0, 0.5, 1.0])
def test_a_short_way_into_the_unknown_is_a_way(slope: float) -> None:
    """A corridor of 2 m with an arm that is known some .8 m or more beyond the corridor's wall."""
    free = grid((90, 20, 110, 280), (110, 140, 140, 160))
    rows, columns = np.indices(free.shape)
    free &= rows < 118 + slope * (columns - 140)
    if slope == 0:
        assert not any(p.kind == "junction" for p in planned(free, CELL)[0])
    beyond = rows >= 118 + slope * (columns - 140)
    frontier = free & binary_dilation(beyond & (columns >= 140) & (columns < 160))
    places, corridors, _ = planned(free, CELL, frontier=frontier)
    (junction,) = [p for p in places if p.kind == "junction"]
    assert np.hypot(*(junction.xy - (15.0, 10.0))) < 0.3
    assert headings_off(junction.branches, [0, np.pi / 2, np.pi]) < 0.3
    ends = [p.kind for p in places if p.kind != "frontier"]
    assert sorted(ends) == ["dead_end", "dead_end", "junction"]
    (up,) = np.flatnonzero(np.abs(junction.branches - np.pi / 2) < 0.5)
    followed = {c.source_branch: places[c.target].kind for c in corridors}
    assert followed.pop(int(up), "frontier") == "frontier"
    assert set(followed.values()) == {"dead_end"}
    assert all(in_free_cells(c.path, free) for c in corridors)


def test_a_way_into_the_unknown_ends_where_that_begins() -> None:
    """A frontier counts in its own cells: in a plan turned by 180 degrees the way is the same."""
    free = grid((90, 20, 110, 280), (110, 140, 200, 160), shape=(220, 300))
    frontier = np.zeros_like(free)
    frontier[199, 140:160] = True
    lengths = [
        next(c.length_m for c in corridors if places[c.target].kind == "frontier")
        for mask, edge in ((free, frontier), (free[::-1, ::-1], frontier[::-1, ::-1]))
        for places, corridors, _ in [planned(mask, CELL, frontier=edge)]
    ]
    assert abs(lengths[0] - lengths[1]) < 0.2 * CELL
