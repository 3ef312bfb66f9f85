"""From identified passes to vertices and corridors, on tracks drawn by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology import mapbuilding
from topobatch.topology.circular import cluster_angles
from topobatch.topology.mapbuilding import build_topomap
from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import NO_BRANCH, Passes
from topobatch.topology.polyline import join_centres, simplify, way_of, with_corners
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import RunNoise
from topobatch.topology.track import track_directions, way_at
from topobatch.topology.vertex_errors import VertexErrors
from topobatch.topology.visits import Visits

STEP_M = 0.1
STEP_NS = 100_000_000


def track(*corners):
    """Odometry along a polyline, exact; the row of each corner."""
    points, rows = [np.array(corners[0], float)], [0]
    for a, b in itertools.pairwise(np.array(corners, float)):
        n = round(float(np.hypot(*(b - a))) / STEP_M)
        points += [a + (b - a) * k / n for k in range(1, n + 1)]
        rows.append(len(points) - 1)
    xy = np.array(points)
    step = np.diff(xy, axis=0, append=2 * xy[-1:] - xy[-2:-1])
    pose = np.column_stack([xy, np.arctan2(step[:, 1], step[:, 0])])
    odometry = Odometry(np.arange(len(pose)) * STEP_NS, pose, np.zeros(0, np.int64))
    return odometry, np.array(rows)


def seen(odometry, rows, branches):
    """Passes at the given rows with the given branches; entry and exit are not used here."""
    p, table = len(rows), Ragged.from_rows(branches)
    when, unknown = odometry.time_ns[rows], np.full(p, NO_BRANCH)
    return Passes(
        when,
        when,
        when,
        odometry.pose[rows, :2],
        table,
        Ragged(table.offsets, np.ones(len(table.values))),
        unknown,
        unknown,
        np.ones(p, int),
        np.ones(p),
    )


def build(odometry, passes, vertex, errors=None, fair=None):
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
    return build_topomap(
        "hand",
        odometry,
        passes,
        xy=passes.centre[first],
        visits=visits,
        pass_vertex=vertex,
        pass_fair=np.ones(len(vertex), bool) if fair is None else np.array(fair),
        pass_turn=np.zeros(len(passes)),
        noise=RunNoise(),
        errors=VertexErrors.none(n) if errors is None else errors,
    )


EAST, NORTH, WEST, SOUTH = 0.0, np.pi / 2, -np.pi, -np.pi / 2


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


def test_two_corridors_between_the_same_junctions_stay_two():
    odometry, rows = track((0, 0), (8, 0), (8, 4), (0, 4), (0, 0))
    passes = seen(odometry, rows[[0, 1, 4]], [[EAST, NORTH], [WEST, NORTH], [EAST, NORTH]])
    m = build(odometry, passes, [0, 1, 0])
    assert m.source.tolist() == m.target.tolist()[::-1] or m.source.tolist() == [0, 0]
    assert sorted(m.length.round(3).tolist()) == [8.0, 16.0]
    longer = int(np.argmax(m.length))
    for corner in ([0, 0], [0, 4], [8, 4], [8, 0]):
        assert np.hypot(*(m.paths[longer] - corner).T).min() < 0.1
    assert len(m.paths[longer]) <= 6


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


def test_turning_back_in_a_corridor_makes_no_edge():
    odometry, rows = track((0, 0), (4, 0), (0, 0))
    passes = seen(odometry, rows[[0, 2]], [[EAST, NORTH]] * 2)
    assert len(build(odometry, passes, [0, 0]).source) == 0


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


def test_the_confidence_of_a_junction_is_the_mean_of_its_passes():
    odometry, rows = track((0, 0), (8, 0), (0, 0), (8, 0))
    passes = seen(odometry, rows, [[EAST], [WEST], [EAST], [WEST]])
    passes = replace(passes, confidence=np.array([1.0, 0.5, 0.5, 1.0]))
    assert build(odometry, passes, [0, 1, 0, 1]).confidence.tolist() == [0.75, 0.75]
    assert build(odometry, passes, [0, -1, 0, 1]).confidence.tolist() == [0.75, 1.0]


def test_a_pass_that_shows_its_junction_otherwise_is_one_by_it_and_no_more():
    odometry, rows = track((0, 0), (8, 0), (0, 0), (8, 0))
    looks = [[EAST], [WEST, NORTH], [EAST], [WEST, SOUTH]]
    m = build(odometry, seen(odometry, rows, looks), [0, 1, 0, 1], fair=[1, 1, 1, 0])
    np.testing.assert_allclose(m.branches[1], [WEST, NORTH])
    assert m.observation_vertex.tolist() == [0, 1, 0, 1]
    assert m.confidence.tolist() == [1.0, 0.5]


def test_angles_cluster_across_the_seam():
    angle = np.array([3.1, -3.1, 0.0, 0.1, 3.0, 1.5])
    owner = np.array([0, 0, 0, 0, 4, 4])
    c = cluster_angles(angle, owner, 0.3)
    assert len(c) == 4
    assert c.of[0] == c.of[1] != c.of[2]
    assert c.of[2] == c.of[3]
    assert c.owner.tolist() == [0, 0, 4, 4]
    assert abs(c.mean[c.of[0]]) == pytest.approx(np.pi)
    assert np.all(np.diff(c.mean[:2]) > 0)
    assert len(cluster_angles(np.zeros(0), np.zeros(0, int), 0.3)) == 0


def test_simplified_lines_stay_near():
    rng = np.random.default_rng(1)
    path = np.cumsum(rng.normal(size=(200, 2)), axis=0)
    thin = simplify(path, 0.5)
    assert 2 <= len(thin) < 200
    assert thin[0].tolist() == path[0].tolist()
    assert thin[-1].tolist() == path[-1].tolist()
    a, b = thin[:-1, None], thin[1:, None]
    t = np.clip(((path - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0, 1)
    off = np.linalg.norm(path - a - t[..., None] * (b - a), axis=-1).min(axis=0)
    assert off.max() <= 0.5 + 1e-9
    closed = simplify(np.array([[0, 0], [1, 0], [1, 1], [0, 0.0]]), 0.1)
    assert len(closed) == 4


def test_the_track_tells_where_the_robot_came_from():
    odometry, rows = track((0, 0), (8, 0), (8, 6))
    told = track_directions(odometry, odometry.time_ns[rows], odometry.pose[rows, :2])
    assert np.isnan(told.arriving[0])
    assert np.isnan(told.leaving[2])
    assert np.cos(told.arriving[1] - WEST) > 0.99
    assert told.leaving[1] == pytest.approx(NORTH)
    assert way_at(odometry, odometry.time_ns[rows]) == pytest.approx([0, 8, 14])


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


def test_a_corner_that_was_cut_is_a_corner():
    angle = np.linspace(-np.pi / 2, 0, 20)[:, None]
    arc = np.array([4.6, 0.4]) + 0.4 * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    driven = np.concatenate([[[0, 0], [2, 0]], arc, [[5, 3], [5, 6]]])
    path = with_corners(driven, 0.5, 0.5)
    assert way_of(driven)[-1] == pytest.approx(10.83, abs=0.01)
    assert way_of(path)[-1] == pytest.approx(11.0, abs=0.01)
    assert np.hypot(*(path - [5, 0]).T).min() < 0.02
    wide = 4 * np.column_stack([np.cos(np.linspace(0, 3, 99)), np.sin(np.linspace(0, 3, 99))])
    assert with_corners(wide, 0.5, 0.5) is wide


def test_what_is_driven_at_a_junction_is_no_part_of_the_corridor():
    past = np.array([[0, 0.1], [-0.3, 0.2], [0.2, 0.1], [1, 0], [4, 0], [5.4, 0], [5.0, 0.3]])
    path = join_centres(past, np.zeros(2), np.array([5.0, 0.0]), 0.7)
    np.testing.assert_allclose(path, [[0, 0], [1, 0], [4, 0], [5, 0]])


def test_detours_are_chosen_where_the_next_drive_is_shorter():
    def legs(*length):
        end = np.array([1.0, 1.0])
        k = len(length)
        zero, one = np.zeros(k, int), np.ones(k, int)
        path = [np.array([[0.0, 0.0], end])] * k
        return mapbuilding._Legs(
            zero, one, zero, zero, np.array(length), path, np.zeros(k, bool), np.zeros((k, 2), int)
        )

    xy = np.array([[0.0, 0.0], [4.0, 0.0]])
    for length, share in (((5.0, 5.0), 0.0), ((4.0, 5.0), 1.0), ((5.0, 6.0), np.sqrt(0.2))):
        found = mapbuilding._chosen_detour(legs(*length), [[0, 1]], xy)
        assert found == pytest.approx(share, abs=1e-9)
    assert mapbuilding._chosen_detour(legs(5.0), [[0]], xy) == 0.0


def test_the_path_is_the_drive_that_the_length_is_of():
    odometry, rows = track((0, 0), (8, 0), (4, 0.7), (0, 0))
    passes = seen(odometry, rows[[0, 1, 3]], [[EAST], [WEST, NORTH], [EAST]])
    m = build(odometry, passes, [0, 1, 0])
    assert m.traversals.tolist() == [2]
    assert m.length[0] == pytest.approx(8.0, abs=0.01)
    assert way_of(m.paths[0])[-1] == pytest.approx(m.length[0], abs=0.01)


@pytest.mark.parametrize("out_m", [0.06, 0.6])
def test_turning_about_within_a_junction_makes_no_corridor(out_m):
    odometry, rows = track((0, 0), (8, 0), (8, out_m), (8, 0), (8, 4))
    seen_by = [[EAST], [WEST, NORTH, SOUTH], [WEST, SOUTH, NORTH], [SOUTH]]
    passes = seen(odometry, rows[[0, 1, 3, 4]], seen_by)
    m = build(odometry, passes, [0, 1, 1, 2])
    assert list(zip(m.source.tolist(), m.target.tolist(), strict=True)) == [(0, 1), (1, 2)]
