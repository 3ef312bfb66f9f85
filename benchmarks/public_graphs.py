"""Public pose graphs in g2o's format, as they are passed around for comparing solvers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from topobatch.topology.posegraph.graph import PoseGraph
from topobatch.topology.se2 import compose, inverse


def read_g2o(path: Path) -> PoseGraph:
    """VERTEX_SE2 and EDGE_SE2 lines, vertices numbered from 0 on.

    Where a file has no vertices, poses come from chained edges.
    """
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([row[1:] for row in rows if row[0] == "VERTEX_SE2"], float).reshape(-1, 4)
    edges = np.array([row[1:] for row in rows if row[0] == "EDGE_SE2"], float)
    source, target = edges[:, :2].T.astype(np.int64)
    upper = np.triu_indices(3)
    information = np.zeros((len(edges), 3, 3))
    information[:, *upper] = information[:, *upper[::-1]] = edges[:, 5:]
    if len(vertices):
        return PoseGraph(vertices[:, 1:], source, target, edges[:, 2:5], information)
    pose = _chained(source, target, edges[:, 2:5])
    return PoseGraph(pose, source, target, edges[:, 2:5], information)


def _chained(source: np.ndarray, target: np.ndarray, measurement: np.ndarray) -> np.ndarray:
    """(n, 3) poses by composing edges, breadth first from pose 0 at the origin."""
    n = int(max(source.max(), target.max())) + 1
    neighbours: list[list] = [[] for _ in range(n)]
    for i, j, T, back in zip(source, target, measurement, inverse(measurement), strict=True):
        neighbours[i].append((j, T))
        neighbours[j].append((i, back))
    pose = np.full((n, 3), np.nan)
    pose[0], queue = 0.0, [0]
    for here in queue:
        for there, step in neighbours[here]:
            if np.isnan(pose[there, 0]):
                pose[there] = compose(pose[here], step)
                queue.append(there)
    return pose
