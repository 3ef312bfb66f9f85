"""Exact odometry along lines drawn by hand."""

from __future__ import annotations

import itertools

import numpy as np

from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import NO_BRANCH, Passes
from topobatch.topology.ragged import Ragged

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


EAST, NORTH, WEST, SOUTH = 0.0, np.pi / 2, -np.pi, -np.pi / 2


def passes_at(time_ns, centre, branches=None, **given):
    """Passes at these times, by rows of branches that all messages saw; entry and exit unknown."""
    when, n = np.asarray(time_ns), len(time_ns)
    rows = Ragged.from_rows([np.zeros(0)] * n) if branches is None else branches
    rows = rows if isinstance(rows, Ragged) else Ragged.from_rows(rows)
    columns = {
        **dict.fromkeys(("time_ns", "start_ns", "end_ns"), when),
        **dict.fromkeys(("entry", "exit"), np.full(n, NO_BRANCH)),
        "centre": np.asarray(centre),
        "branches": rows,
        "messages": np.ones(n, int),
        "confidence": np.ones(n),
    }
    return Passes(**{**columns, **given})
