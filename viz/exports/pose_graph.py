"""Pose graphs in the g2o format, which GTSAM, SE-Sync and g2o read.

    VERTEX_SE2 id x y theta
    EDGE_SE2 id_from id_to dx dy dtheta I11 I12 I13 I22 I23 I33

(Kümmerle, Grisetti, Strasdat, Konolige, Burgard: g2o, ICRA 2011; its wiki, "File format".)
"""

from __future__ import annotations

import numpy as np

from ...topology.digits import TURN
from ...topology.posegraph.graph import PoseGraph


def pose_graph_g2o(graph: PoseGraph) -> str:
    """The poses of a graph, numbered from 0, and its edges; priors and robust kernels are left out.

    Numbers are rounded as in documents, so that they are the same on every processor. No comments
    are written: GTSAM 4.3 reads no edges from a file that has any.
    """
    poses = (np.round(graph.pose, TURN) + 0.0).tolist()
    measured = (np.round(graph.measurement, TURN) + 0.0).tolist()
    upper = graph.information[:, *np.triu_indices(3)].tolist()
    ends = zip(graph.source.tolist(), graph.target.tolist(), strict=True)
    lines = [_line("VERTEX_SE2", k, *pose) for k, pose in enumerate(poses)]
    lines += [
        _line("EDGE_SE2", *pair, *step, *(float(f"{value:.6e}") + 0.0 for value in row))
        for pair, step, row in zip(ends, measured, upper, strict=True)
    ]
    return "".join(lines)


def _line(tag: str, *values: float) -> str:
    """A line of numbers, each in the shortest form that reads back as the same float."""
    return " ".join([tag, *map(repr, values)]) + "\n"
