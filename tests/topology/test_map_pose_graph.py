"""Maps as pose graphs: what an edge measures, how well, and that loops measure nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.map_pose_graph import LEAST_STEP_M, map_pose_graph
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import between
from topobatch.topology.topomap import RunNoise, TopoMap


def elbow(traversals: int) -> TopoMap:
    """Two corridors at a right angle, and one that comes back to where it left."""
    xy = np.array([(0.0, 0.0), (8.0, 0.0), (8.0, 6.0)])
    ends = np.array([(0, 1), (1, 2), (2, 2)])
    return TopoMap(
        run="elbow",
        frame="odom",
        xy=xy,
        branches=Ragged.from_rows([[0.0], [-np.pi, np.pi / 2], [-np.pi / 2, 0.3, 1.0]]),
        kind=("dead_end", "bend", "junction"),
        source=ends[:, 0],
        target=ends[:, 1],
        source_branch=np.array([0, 1, 1]),
        target_branch=np.array([0, 0, 2]),
        length=np.array([8.0, 6.0, 5.0]),
        length_sigma=np.full(3, LEAST_STEP_M),  # no more than odometry and centres explain
        traversals=np.full(3, traversals),
        paths=(xy[:2], xy[1:], xy[[2, 0, 2]]),
        observation_vertex=np.repeat(np.arange(3), traversals),
        observation_time_ns=np.arange(3 * traversals),
    )


def test_edges_measure_the_steps_of_the_map() -> None:
    graph = map_pose_graph(elbow(1))
    assert (graph.source.tolist(), graph.target.tolist()) == ([0, 1], [1, 2])
    steps = between(graph.pose[graph.source], graph.pose[graph.target])
    np.testing.assert_allclose(graph.measurement, steps, atol=1e-12)


def test_corridors_are_known_better_along_than_across_and_the_more_often_driven() -> None:
    once, often = (np.linalg.inv(map_pose_graph(elbow(count)).information) for count in (1, 16))
    # The first runs along x, the second along y.
    for covariance in (once, often):
        assert covariance[0, 0, 0] < covariance[0, 1, 1]
        assert covariance[1, 1, 1] < covariance[1, 0, 0]
    assert np.all(np.linalg.eigvalsh(once - often) > -1e-9)


def test_a_heading_that_walks_at_random_turns_a_corridor_by_a_third() -> None:
    walk, turns = 0.01**2, 0.02**2
    noise = RunNoise(1e-6, walk**0.5, turns**0.5, 0.0, 0.0, 0.05)
    graph = map_pose_graph(replace(elbow(1), fitted_noise=noise))
    covariance = np.linalg.inv(graph.information[0])
    # Across a corridor of 8 m; half of the turns of a quarter of π in the mean are at each end.
    swing = turns * np.pi / 8
    assert covariance[1, 1] == pytest.approx((walk * 8 / 3 + swing) * 64, rel=0.01)
    assert covariance[1, 2] == pytest.approx((walk * 8 / 2 + swing) * 8, rel=0.01)
    assert covariance[2, 2] == pytest.approx(walk * 8 + 2 * swing, rel=0.01)


def test_a_corridor_that_loop_closure_discounted_measures_no_more_than_its_length_is_sure_of():
    plain = elbow(1)
    doubted = replace(plain, length_sigma=np.array([0.8, 0.001, 0.001]))
    before, after = (np.linalg.inv(map_pose_graph(m).information) for m in (plain, doubted))
    assert before[0, 0, 0] < 0.05**2
    assert after[0, 0, 0] == pytest.approx(0.8**2, rel=0.05)
    # Of such a drive neither the way nor the turn is known.
    np.testing.assert_allclose(after[0] / after[0, 0, 0], before[0] / before[0, 0, 0])
    np.testing.assert_allclose(after[1], before[1])
    # A junction in scans may be seen worse than most, by all passes alike.
    scanned = replace(doubted, fitted_noise=replace(doubted.measured, shared_centre_m=0.1))
    unchanged = np.linalg.inv(map_pose_graph(scanned).information)
    np.testing.assert_allclose(unchanged, before)
