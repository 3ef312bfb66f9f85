"""Rooms and doors of grids drawn by hand."""

from __future__ import annotations

import numpy as np

from topobatch.ingest.scans.floorplan import Floorplan, Place
from topobatch.ingest.scans.rooms import doors
from topobatch.ingest.scans.skeleton import Edge, Node, SkeletonGraph

from .plans import planned

CELL = 0.05


def floor(*boxes: tuple[float, float, float, float], size: tuple[float, float]) -> np.ndarray:
    """Free cells within boxes of x, y, to x and to y [m]."""
    free = np.zeros([round(n / CELL) for n in size[::-1]], bool)
    for box in boxes:
        x, y, to_x, to_y = (round(n / CELL) for n in box)
        free[y:to_y, x:to_x] = True
    return free


HALL = (1.0, 5.0, 21.0, 6.6)
ROOMS = [(1.0, 1.0, 5.0, 4.8), (5.2, 1.0, 10.0, 4.8), (10.2, 6.8, 15.0, 11.0)]
DOORS = [(2.0, 4.7, 2.9, 5.1), (8.0, 4.7, 8.9, 5.1), (12.0, 6.5, 12.9, 6.9)]
SIZE = (22.0, 12.0)


def of_kind(plan: Floorplan, kind: str) -> list[Place]:
    return [place for place in plan.places if place.kind == kind]


def test_rooms_lie_behind_doors_that_have_a_width() -> None:
    plan = planned(floor(HALL, *ROOMS, *DOORS, size=SIZE), CELL)
    rooms, doors = of_kind(plan, "room"), of_kind(plan, "door")
    assert len(rooms) == len(doors) == 3
    for x, y, to_x, to_y in ROOMS:
        middle = np.array([x + to_x, y + to_y]) / 2
        near = min(rooms, key=lambda place: float(np.hypot(*(place.xy - middle))))
        assert np.hypot(*(near.xy - middle)) < 0.5
        assert near.area_m2 is not None
        np.testing.assert_allclose(near.area_m2, (to_x - x) * (to_y - y), rtol=0.06)
        assert len(near.branches) == 1
    for x, y, to_x, to_y in DOORS:
        middle = np.array([x + to_x, y + to_y]) / 2
        near = min(doors, key=lambda place: float(np.hypot(*(place.xy - middle))))
        assert np.hypot(*(near.xy - middle)) < 0.3
        assert near.width_m is not None
        np.testing.assert_allclose(near.width_m, 0.9, atol=1.5 * CELL)
        assert len(near.branches) == 2
    at = {k for k, place in enumerate(plan.places) if place.kind == "door"}
    ends = [end for c in plan.corridors for end in (c.source, c.target)]
    assert all(ends.count(k) == 2 for k in at)
    # A corridor has room for what passes, and is none.
    assert all(place.area_m2 is None for place in plan.places if place.kind != "room")


def test_a_room_with_two_doors_has_a_way_to_each() -> None:
    second = (9.9, 2.0, 10.3, 2.9)
    beyond = (10.2, 1.0, 14.0, 4.8)
    plan = planned(floor(HALL, *ROOMS, beyond, *DOORS, second, size=SIZE), CELL)
    (room,) = [p for p in of_kind(plan, "room") if 5.2 < p.xy[0] < 10.0]
    assert len(room.branches) == 2


def test_a_door_is_a_cell_of_its_edge_however_large_cells_are() -> None:
    wide, narrow = (Node(np.zeros(2), clear, (0,)) for clear in (0.9, 0.45))
    edge = Edge((0, 1), np.array([[1, 1]]), 0.6)
    graph = SkeletonGraph((wide, narrow), (edge,), np.full((3, 3), 0.33), 1 / 3)
    assert [door.at for door in doors(graph)] == [0]
