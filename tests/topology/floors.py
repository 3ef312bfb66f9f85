"""A floor of walls drawn at random, and the views that it offers."""

from __future__ import annotations

import numpy as np

from topobatch.topology.views import REACH_M, SIDE, Views, view_cells

CELL_M = 0.1
SIZE_M = 60.0


def floor(seed):
    """(n, n) cells that are walls: boxes and short walls at random places."""
    rng = np.random.default_rng(seed)
    n = int(SIZE_M / CELL_M)
    wall = np.zeros((n, n), bool)
    for _ in range(220):
        x, y = rng.integers(0, n, 2)
        long, thick = rng.integers(10, 50), 2
        w, h = (long, thick) if rng.random() < 0.5 else (thick, long)
        wall[y : y + h, x : x + w] = True
    return wall


def views_at(wall, poses, *, known=None, time_ns=None):
    """Views of a floor in frames at `poses` (k, 3); cells where `known` is False are unknown."""
    step = (np.arange(2 * SIDE) + 0.5) * CELL_M - REACH_M
    x, y = np.meshgrid(step, step)
    cells = []
    for px, py, theta in np.asarray(poses, float):
        wx = px + np.cos(theta) * x - np.sin(theta) * y
        wy = py + np.sin(theta) * x + np.cos(theta) * y
        j, i = (np.floor(w / CELL_M).astype(int) for w in (wx, wy))
        inside = (j >= 0) & (i >= 0) & (j < len(wall)) & (i < len(wall))
        hit = np.where(inside, wall[i.clip(0, len(wall) - 1), j.clip(0, len(wall) - 1)], False)
        seen = inside if known is None else inside & known(wx, wy)
        cells.append(view_cells(4 * (hit & seen), 4 * (~hit & seen)))
    times = np.arange(len(cells)) if time_ns is None else time_ns
    return Views(times, np.asarray(poses, float), np.array(cells))
