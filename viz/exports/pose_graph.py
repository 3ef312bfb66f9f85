"""Pose graphs in g2o's format, for GTSAM, SE-Sync, g2o and whatever else solves them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...topology.digits import TURN
from ...topology.posegraph.g2o import g2o_text
from ...topology.posegraph.graph import PoseGraph

_SEVEN_DIGITS = np.vectorize(lambda value: float(f"{value:.6e}") + 0.0, otypes=[np.float64])


def pose_graph_g2o(graph: PoseGraph, where: Sequence[tuple[str, int]]) -> str:
    """The graph, its poses numbered from 0 on; comments say which junction of which run each is.

    Numbers are rounded as in documents, so that they are the same on every processor.
    """
    rounded = replace(
        graph,
        pose=np.round(graph.pose, TURN) + 0.0,
        measurement=np.round(graph.measurement, TURN) + 0.0,
        information=_SEVEN_DIGITS(graph.information),
    )
    names = (run if run.isprintable() else ascii(run) for run, _ in where)
    comments = [
        f"{k} is junction {vertex} of {run}"
        for k, ((_, vertex), run) in enumerate(zip(where, names, strict=True))
    ]
    return g2o_text(rounded, comments=comments)
