"""Views along the track, and the track laid out again where they show that it came by again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.closure.dead_reckoning import dead_reckoning
from ...topology.closure.view_loops import view_loops
from ...topology.matching.views import ViewIndex
from ...topology.odometry import Odometry
from ...topology.passes import NO_BRANCH, Passes
from ...topology.ragged import Ragged
from ...topology.run import NOT_SEEN_AGAIN, ScanPasses, SeenAgain
from ...topology.se2 import turned, wrap
from ...topology.topomap import RunNoise
from ...topology.track import way_at
from ...topology.views import NO_VIEWS, Views
from .junctions import Driven
from .windows import Seen

EVERY_M = 3.0
"""Way between views where there is no junction."""


def chosen_views(seen: Sequence[Seen], passes: ScanPasses, driven: Driven) -> Views:
    """The views of the windows nearest to passes, and of others every `EVERY_M`, posed in the
    frame of the track."""
    if not seen:
        return NO_VIEWS
    way = np.array([window.way for window in seen])
    at = np.interp(passes.time_ns.astype(np.float64), driven.time_ns.astype(np.float64), driven.way)
    near = np.searchsorted(0.5 * (way[1:] + way[:-1]), at)
    wanted = np.zeros(len(way), bool)
    wanted[near] = True
    last = -np.inf
    following = np.append(way[wanted], np.inf)
    for k, here in enumerate(way.tolist()):
        ahead = following[np.searchsorted(following, here)]
        if wanted[k] or (here - last >= EVERY_M and ahead - here >= EVERY_M / 2):
            wanted[k], last = True, here
    kept = [window for window, some in zip(seen, wanted, strict=True) if some]
    keyframe = np.minimum(np.searchsorted(driven.way, way[wanted]), len(driven.way) - 1)
    pose = np.zeros((len(kept), 3))
    pose[:, :2] = [window.place for window in kept]
    return Views(driven.time_ns[keyframe], pose, np.array([window.view for window in kept]))


def closed_by_views(
    odometry: Odometry, views: Views, noise: RunNoise
) -> tuple[Odometry, Views, SeenAgain, RunNoise]:
    """The odometry and its views, laid out again by the loops that the views show; the loops; and
    the noise of the odometry, raised if it does not explain what they show."""
    count = len(views)
    none = Ragged(np.zeros(count + 1, np.int64), np.zeros(0))
    unknown = np.full(count, NO_BRANCH)
    times = views.time_ns
    nodes = Passes(
        *(times, times, times, views.pose[:, :2], none, none, unknown, unknown),
        messages=np.ones(count, np.int64),
        confidence=np.ones(count),
    )
    if count < 2:
        return odometry, views, NOT_SEEN_AGAIN, noise
    reckoning = dead_reckoning(odometry, nodes, noise)
    closed, estimate = view_loops(reckoning, ViewIndex.of(views), way_at(odometry, times))
    loops, pose = closed.loops, estimate.pose
    # Each node's pose tells how the frame of the odometry is to be moved there.
    moved = _moved(odometry, times, views.pose[:, :2], pose, reckoning.piece)
    placed = np.column_stack([pose[:, :2], wrap(views.pose[:, 2] + pose[:, 2])])
    back = _axes(pose[loops.second, 2])
    information = back @ loops.information @ back.transpose(0, 2, 1)
    return (
        replace(odometry, pose=moved),
        Views(views.time_ns, placed, views.cells),
        SeenAgain(times[loops.first], times[loops.second], information),
        replace(closed.noise, centre_m=noise.centre_m, branch_rad=noise.branch_rad),
    )


def _axes(turn: FloatArray) -> FloatArray:
    """(k, 3, 3) rotations of x, y in x, y, theta."""
    out = np.zeros((len(turn), 3, 3))
    c, s = np.cos(turn), np.sin(turn)
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1], out[:, 2, 2] = c, -s, s, c, 1.0
    return out


def _moved(
    odometry: Odometry, times: IntArray, place: FloatArray, pose: FloatArray, piece: IntArray
) -> FloatArray:
    """(n, 3) poses of the odometry, moved with the places (k, 2) that it passed at `times` (k,) to
    where these are now, `pose` (k, 3), and interpolated in between by the distance driven."""
    out = odometry.pose.copy()
    cuts = [0, *odometry.breaks.tolist(), len(odometry)]
    way, at = np.cumsum(odometry.step_m), way_at(odometry, times)
    for number, (begin, end) in enumerate(pairwise(cuts)):
        own = np.flatnonzero(piece == number)
        if not len(own):
            continue
        rows = slice(begin, end)
        before = np.clip(np.searchsorted(at[own], way[rows], side="right") - 1, 0, len(own) - 1)
        after = np.minimum(before + 1, len(own) - 1)
        one, two = own[before], own[after]
        length = at[two] - at[one]
        share = np.clip((way[rows] - at[one]) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        turn = pose[one, 2] + share * wrap(pose[two, 2] - pose[one, 2])
        xy = [
            pose[k, :2] + turned(odometry.pose[rows, :2] - place[k], pose[k, 2]) for k in (one, two)
        ]
        out[rows, :2] = (1 - share)[:, None] * xy[0] + share[:, None] * xy[1]
        out[rows, 2] = wrap(odometry.pose[rows, 2] + turn)
    return out
