"""Layout of the pieces of a run whose odometry broke: their relative poses are unknown, and they
are drawn side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import IntArray
from .dead_reckoning import DeadReckoning
from .estimate import Estimate


def set_apart(
    reckoning: DeadReckoning, place: IntArray, estimate: Estimate, gap_m: float = 20.0
) -> Estimate:
    """The estimate with its pieces side by side along x, `gap_m` apart [m].

    place: (p,) of each pass, numbered from 0. A piece are the passes of one unbroken piece of
    odometry. Only `pose` and `xy` of the result are moved.
    """
    pieces = np.unique(reckoning.piece)
    if len(pieces) < 2:
        return estimate
    pose, xy = estimate.pose.copy(), estimate.xy.copy()
    piece_of = np.zeros(len(xy), np.int64)
    piece_of[place[place >= 0]] = reckoning.piece[place >= 0]
    edge = None
    for piece in pieces.tolist():
        mine = reckoning.piece == piece
        low, high = pose[mine, 0].min(), pose[mine, 0].max()
        shift = 0.0 if edge is None else edge + gap_m - low
        pose[mine, 0] += shift
        xy[piece_of == piece, 0] += shift
        edge = high + shift
    return replace(estimate, pose=pose, xy=xy)
