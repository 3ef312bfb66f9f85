"""Places and corridors of grids drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from topobatch.ingest.scans.floorplan import Floorplan, skeleton_graph
from topobatch.ingest.scans.grid import GridSettings, without_islands
from topobatch.topology.polyline import way_of
from topobatch.topology.se2 import wrap


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
    places, corridors, _ = skeleton_graph(CROSS, CELL)
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


def test_ring_hangs_on_its_place_by_two_branches() -> None:
    free = grid((20, 20, 40, 280), (20, 180, 180, 200), (160, 180, 180, 280), (20, 260, 180, 280))
    places, corridors, _ = skeleton_graph(free, CELL)
    (junction,) = [k for k, p in enumerate(places) if p.kind == "junction"]
    (ring,) = [c for c in corridors if c.source == c.target]
    assert ring.source == junction
    assert ring.source_branch != ring.target_branch
    assert ring.length_m == pytest.approx(2 * (8 + 14), rel=0.1)
    assert in_free_cells(ring.path, free)


def test_pillars_corners_and_narrow_gaps_are_no_junctions() -> None:
    """A pillar, a gap of 0.3 m and a corner beside one side corridor, which makes the only one."""
    rooms = (80, 20, 120, 280), (120, 150, 190, 153), (10, 235, 80, 265), (120, 60, 190, 90)
    free = grid(*rooms)
    free[98:102, 150:154] = False
    places = skeleton_graph(without_islands(free, GridSettings(cell_m=CELL)), CELL).places
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
        assert not any(p.kind == "junction" for p in skeleton_graph(free, CELL)[0])
    beyond = rows >= 118 + slope * (columns - 140)
    frontier = free & binary_dilation(beyond & (columns >= 140) & (columns < 160))
    places, corridors, _ = skeleton_graph(free, CELL, frontier=frontier)
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


def test_a_gap_that_no_robot_fits_through_opens_nothing() -> None:
    free = grid((90, 20, 110, 280), (110, 140, 140, 160))
    frontier = np.zeros_like(free)
    frontier[139, 148:152] = True
    places = skeleton_graph(free, CELL, frontier=frontier).places
    assert sorted(p.kind for p in places) == ["dead_end"] * 3 + ["junction"]


@pytest.mark.parametrize("turns", range(2))
def test_a_dead_end_is_in_the_middle_of_its_room(turns: int) -> None:
    rooms = grid((10, 30, 41, 58), (41, 36, 61, 54), (61, 5, 79, 290))
    free = np.ascontiguousarray(np.rot90(rooms, turns))
    places = skeleton_graph(free, CELL).places
    middle = np.zeros_like(rooms)
    middle[25, 44] = True
    row, column = np.argwhere(np.rot90(middle, turns))[0]
    away = [np.hypot(*(p.xy - (CELL * (column + 0.5), CELL * (row + 0.5)))) for p in places]
    nearest = int(np.argmin(away))
    assert places[nearest].kind == "dead_end"
    assert away[nearest] < 0.15


def test_nothing_free() -> None:
    assert skeleton_graph(np.zeros((20, 30), bool), CELL) == Floorplan((), ())
    assert skeleton_graph(np.zeros((0, 0), bool), CELL) == Floorplan((), ())
    assert skeleton_graph(grid((10, 10, 12, 12)), CELL) == Floorplan((), ())
