"""Ways driven out of a junction and back, on tracks drawn by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.errors import DocumentError
from topobatch.topology.mapbuilding import build_topomap
from topobatch.topology.topomap import RunNoise, TopoMap
from topobatch.topology.turning_back import turning_points
from topobatch.topology.turning_points import TRACK_END, TURNING_POINT
from topobatch.topology.turning_vertices import with_turning_points, without_turning_points
from topobatch.topology.vertex_errors import VertexErrors
from topobatch.topology.visits import PassesAtPlaces, Visits

from .tracks import EAST, NORTH, SOUTH, WEST, passes_at, track

LEAST_M = 1.0


def driven(
    corners: list[tuple[float, float]],
    at: list[int],
    vertex: list[int],
    branches: dict[int, list[float]],
) -> TopoMap:
    """The map of a track through `corners`, which passed vertices at some of them."""
    odometry, rows = track(*corners)
    rows, of = rows[at], np.array(vertex)
    when, n = odometry.time_ns[rows], len(set(vertex))
    centre = odometry.pose[rows, :2]
    passes = passes_at(when, centre, [branches[v] for v in vertex])
    pose = np.column_stack([centre, np.zeros(len(rows))])
    seen, piece = np.ones(len(rows), bool), np.zeros(len(rows), int)
    visits = Visits(when, of, seen, pose, centre, piece)
    xy = centre[[vertex.index(v) for v in range(n)]]
    m = build_topomap(
        "hand",
        odometry,
        passes,
        PassesAtPlaces(of, seen, np.zeros(len(rows)), xy, visits),
        noise=RunNoise(),
        errors=VertexErrors(np.zeros((n, 3, 1))),
    )
    turned = turning_points(m, odometry, visits, LEAST_M)
    return replace(m, turning_points=turned)


CORRIDOR = {0: [EAST, NORTH, WEST], 1: [EAST, NORTH, WEST]}


def with_room(deep: float = 4.0) -> TopoMap:
    """Junction 0, a room to its north driven into and out of, and a corridor to junction 1."""
    corners = [(0, 0), (0, deep), (0, 0), (10, 0)]
    return driven(corners, [0, 2, 3], [0, 0, 1], CORRIDOR)


def test_a_room_driven_into_and_out_of_ends_at_a_turning_point():
    m = with_room()
    t = m.turning_points
    assert (t.kind, t.vertex.tolist(), t.traversals.tolist()) == ((TURNING_POINT,), [0], [2])
    assert m.branches[0][t.branch[0]] == pytest.approx(NORTH)
    np.testing.assert_allclose(t.xy, [[0, 4]], atol=0.05)
    assert t.length[0] == pytest.approx(4.0, abs=0.05)
    assert t.heading[0] == pytest.approx(SOUTH, abs=0.05)
    assert len(m.source) == 1
    # There and back: the robot is at the point in between.
    (out, there), (back, left) = t.traversal_ns[0].tolist()
    assert out < there <= left < back
    assert abs(t.time_ns[0][0, 0] - there) < 1e9


def test_a_log_that_begins_and_ends_between_junctions():
    corners = [(-5, 0), (0, 0), (10, 0), (10, 6)]
    t = driven(corners, [1, 2], [0, 1], CORRIDOR).turning_points
    assert t.kind == (TRACK_END, TRACK_END)
    np.testing.assert_allclose(t.xy, [[-5, 0], [10, 6]], atol=0.05)
    assert t.traversals.tolist() == [1, 1]
    (at, begin), (leave, end) = t.traversal_ns[0][0].tolist(), t.traversal_ns[1][0].tolist()
    assert begin < at < leave < end


def test_a_document_whose_turning_points_are_none_is_refused():
    doc = map_to_document(with_room())
    doc["nodes"][0]["kind"] = "turning_point"
    with pytest.raises(DocumentError, match="turning points come last"):
        map_from_document(doc)


def test_vertices_of_turning_points_and_back():
    m = with_room()
    whole = with_turning_points(m)
    assert (len(whole), len(whole.source), len(whole.turning_points)) == (3, 2, 0)
    back = without_turning_points(whole)
    assert map_to_document(back) == map_to_document(m)
    assert without_turning_points(back) is back
