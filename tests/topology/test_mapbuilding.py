"""From identified passes to vertices and corridors, on tracks drawn by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.mapbuilding import build_topomap
from topobatch.topology.topomap import RunNoise
from topobatch.topology.vertex_errors import VertexErrors
from topobatch.topology.visits import PassesAtPlaces, Visits

from .tracks import EAST, NORTH, SOUTH, WEST, passes_at, track


def seen(odometry, rows, branches):
    """Passes at the given rows with the given branches."""
    return passes_at(odometry.time_ns[rows], odometry.pose[rows, :2], branches)


def build(odometry, passes, vertex, errors=None, fair=None, *, askew_rad=0.0):
    vertex = np.asarray(vertex)
    n = vertex.max() + 1
    first = [int(np.flatnonzero(vertex == k)[0]) for k in range(n)]
    keep = np.flatnonzero(vertex >= 0)
    pose = np.column_stack([passes.centre, np.zeros(len(passes))])
    visits = Visits(
        passes.time_ns[keep],
        vertex[keep],
        np.ones(len(keep), bool),
        pose[keep],
        passes.centre[keep],
        np.zeros(len(keep), int),
    )
    fair = np.ones(len(vertex), bool) if fair is None else np.array(fair)
    return build_topomap(
        "hand",
        odometry,
        passes,
        PassesAtPlaces(vertex, fair, np.zeros(len(passes)), passes.centre[first], visits),
        askew_rad=askew_rad,
        noise=RunNoise(),
        errors=VertexErrors(np.zeros((n, 3, 1))) if errors is None else errors,
    )


def test_a_corridor_driven_both_ways_is_one_edge():
    odometry, rows = track((0, 0), (8, 0), (0, 0))
    passes = seen(odometry, rows, [[EAST], [WEST, NORTH], [EAST]])
    m = build(odometry, passes, [0, 1, 0])
    assert (m.source.tolist(), m.target.tolist(), m.traversals.tolist()) == ([0], [1], [2])
    assert m.length[0] == pytest.approx(8.0)
    assert m.branches[0][m.source_branch[0]] == pytest.approx(EAST)
    assert m.branches[1][m.target_branch[0]] == pytest.approx(WEST)
    assert m.kind == ("dead_end", "bend")
    np.testing.assert_allclose(m.paths[0], [[0, 0], [8, 0]], atol=1e-9)


def test_a_loop_keeps_both_its_branches():
    odometry, rows = track((0, 0), (6, 0), (6, 6), (0, 6), (0, 0))
    passes = seen(odometry, rows[[0, 4]], [[EAST, NORTH]] * 2)
    m = build(odometry, passes, [0, 0])
    assert (m.source[0], m.target[0]) == (0, 0)
    assert {int(m.source_branch[0]), int(m.target_branch[0])} == {0, 1}
    assert m.length[0] == pytest.approx(24.0)
    along = m.paths[0][1] - m.paths[0][0]
    assert np.arctan2(along[1], along[0]) == pytest.approx(
        m.branches[0][m.source_branch[0]], abs=0.2
    )


def test_a_dissolved_pass_joins_its_two_legs():
    odometry, rows = track((0, 0), (4, 0), (8, 0))
    passes = seen(odometry, rows, [[EAST], [EAST, WEST], [WEST]])
    m = build(odometry, passes, [0, -1, 1])
    assert m.length.tolist() == [pytest.approx(8.0)]
    assert m.observation_vertex.tolist() == [0, 1]


def test_branches_stay_by_majority_or_because_they_were_driven():
    odometry, rows = track((0, 0), (8, 0), (0, 0), (8, 0), (0, 0), (8, 0))
    looks = [[EAST], [WEST, NORTH], [EAST, SOUTH], [WEST], [EAST], [WEST]]
    m = build(odometry, seen(odometry, rows, looks), [0, 1, 0, 1, 0, 1])
    np.testing.assert_allclose(m.branches[0], [EAST])
    np.testing.assert_allclose(m.branches[1], [WEST])
    odometry, rows = track((0, 0), (8, 0), (8, 6))
    driven = build(odometry, seen(odometry, rows, [[EAST], [WEST, NORTH], [SOUTH]]), [0, 1, 2])
    np.testing.assert_allclose(driven.branches[1], [WEST, NORTH])


def test_a_junction_that_shows_otherwise_each_time_keeps_the_branch_seen_most() -> None:
    odometry, rows = track(*[(8.0 * (k % 2), 0.0) for k in range(12)])
    looks = [[EAST], [NORTH]] * 6
    for k, branch in enumerate((1.0, 2.2, 2.2, -1.0, -2.2, 1.6)):
        looks[2 * k + 1] = [branch]
    m = build(odometry, seen(odometry, rows, looks), [0, 1] * 6)
    np.testing.assert_allclose(m.branches[1], [2.2])


def test_a_pass_that_shows_its_junction_otherwise_is_one_by_it_and_no_more():
    odometry, rows = track((0, 0), (8, 0), (0, 0), (8, 0))
    looks = [[EAST], [WEST, NORTH], [EAST], [WEST, SOUTH]]
    m = build(odometry, seen(odometry, rows, looks), [0, 1, 0, 1], fair=[1, 1, 1, 0])
    np.testing.assert_allclose(m.branches[1], [WEST, NORTH])
    assert m.observation_vertex.tolist() == [0, 1, 0, 1]
    assert m.confidence.tolist() == [1.0, 0.5]


def test_a_corridor_is_as_long_as_from_centre_to_centre():
    """The robot stops short of one centre, overshoots the other and passes beside both."""
    odometry, rows = track((0.3, 0.2), (0.7, 0), (6, 0), (8.3, 0), (8.3, 0.2))
    passes = seen(odometry, rows[[0, 4]], [[EAST], [WEST]])
    centres = np.array([[0.0, 0.0], [8.0, 0.0]])
    errors = np.zeros((2, 3, 4))
    errors[1, 0] = [0.1, -0.1, 0.1, -0.1]
    errors[1, 1] = 5.0  # across the corridor: no error of its length
    m = build(odometry, replace(passes, centre=centres), [0, 1], VertexErrors(errors))
    assert m.length[0] == pytest.approx(8.0, abs=0.01)
    assert m.length_sigma[0] == pytest.approx(0.1, rel=0.02)
    np.testing.assert_allclose(m.paths[0], centres, atol=1e-9)
