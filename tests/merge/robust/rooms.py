"""Views of simple rooms, for tests."""

import numpy as np

from topobatch.topology.views import CELL_M, REACH_M, SIDE, Views


def walls_of(seed: int, size_m: float | tuple[float, float] = 40.0) -> np.ndarray:
    """(k, 4) walls x0, y0, x1, y1 [m] along two axes, at random."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(0, size_m, (60, 2))
    long = rng.uniform(2, 8, 60)
    along = rng.integers(0, 2, 60)
    end = start + np.stack([long * (along == 0), long * (along == 1)], axis=1)
    return np.concatenate([start, end], axis=1)


def views_of(walls: np.ndarray, places: np.ndarray, frame=(0.0, 0.0, 0.0)) -> Views:
    """Views at places (n, 2) of a world of walls, all around known, posed in a frame (pose of the
    world in it)."""
    share = np.linspace(0, 1, 200)[:, None, None]
    points = (walls[:, :2] + share * (walls[:, 2:] - walls[:, :2])).reshape(-1, 2)
    x, y, theta = frame
    c, s = np.cos(theta), np.sin(theta)
    step = (np.arange(SIDE) + 0.5) * CELL_M - REACH_M
    inside = np.hypot(step[:, None], step) <= REACH_M
    cells = []
    for place in places:
        off = points - place
        # The axes of views are those of the map's frame.
        off = np.stack([c * off[:, 0] - s * off[:, 1], s * off[:, 0] + c * off[:, 1]], axis=1)
        at = np.floor((off + REACH_M) / CELL_M).astype(int)
        at = at[((at >= 0) & (at < SIDE)).all(axis=1)]
        cell = np.ones((SIDE, SIDE), np.uint8)
        cell[at[:, 1], at[:, 0]] = 2
        cells.append(np.where(inside, cell, 0))
    xy = np.stack(
        [x + c * places[:, 0] - s * places[:, 1], y + s * places[:, 0] + c * places[:, 1]], axis=1
    )
    pose = np.column_stack([xy, np.zeros(len(places))])
    return Views(np.arange(len(places)) * 10**9, pose, np.array(cells, np.uint8))


def line(first: tuple[float, float], last: tuple[float, float], count: int = 10) -> np.ndarray:
    """(count, 2) places along a line."""
    return np.linspace(first, last, count)
