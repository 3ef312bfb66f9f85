"""Pose graphs in g2o's format, for GTSAM, SE-Sync, g2o and whatever else solves them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...topology.digits import TURN
from ...topology.posegraph.g2o import g2o_text
from ...topology.posegraph.graph import PoseGraph

_SEVEN_DIGITS = np.vectorize(lambda value: float(f"{value:.6e}") + 0.0, otypes=[np.float64])


def pose_graph_g2o(graph: PoseGraph) -> str:
    """The graph, its poses numbered from 0 on.

    Numbers are rounded as in documents, so that they are the same on every processor.
    """
    rounded = replace(
        graph,
        pose=np.round(graph.pose, TURN) + 0.0,
        measurement=np.round(graph.measurement, TURN) + 0.0,
        information=_SEVEN_DIGITS(graph.information),
    )
    return g2o_text(rounded)
