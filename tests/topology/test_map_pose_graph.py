"""Maps as pose graphs: what an edge measures, how well, and that loops measure nothing."""

from __future__ import annotations

import numpy as np

from topobatch.topology.corridor_lengths import LEAST_M
from topobatch.topology.map_pose_graph import map_pose_graph
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import between
from topobatch.topology.topomap import TopoMap


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
        length_sigma=np.full(3, LEAST_M),  # no more than odometry and centres explain
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
