"""Pose graphs, read by GTSAM."""

from __future__ import annotations

import numpy as np

from topobatch.topology.map_pose_graph import map_pose_graph
from topobatch.viz.exports.pose_graph import pose_graph_g2o

from .readers import read_g2o


def test_poses_and_measurements_are_those_of_the_map(driven, tmp_path) -> None:
    given = map_pose_graph(driven[1])
    graph = read_g2o(pose_graph_g2o(given), tmp_path)
    np.testing.assert_allclose(graph.pose, given.pose, atol=1e-6)
    np.testing.assert_array_equal(graph.ends, np.column_stack([given.source, given.target]))
    np.testing.assert_allclose(graph.measurement, given.measurement, atol=1e-6)
    np.testing.assert_allclose(graph.information, given.information, rtol=1e-5, atol=1e-3)
