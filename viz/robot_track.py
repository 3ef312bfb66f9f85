"""The robot's track on its map: odometry placed rigidly, and corrected to pass through the map's
vertices."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.odometry import Odometry
from ..topology.se2 import apply, compose, fit_rigid
from ..topology.topomap import TopoMap
from ..topology.track import stretch_of
from .geometry import FINEST_M, thinned

MOST_POINTS = 20_000
"""About the most points of a drawn track."""

SHORT_CHORD_M = 0.5
"""Two passes closer than this give no direction between them."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotTrack:
    """A run's track in its map's frame, thinned for drawing; all poses (x, y, theta).

    time_ns: (n,); raw: (n, 3) odometry, each unbroken stretch moved rigidly to the least-squares
    fit of its passes to the map's vertices; bent: (n, 3) the same rows, corrected so that every
    pass lies on its vertex; starts: rows at which a stretch begins (never 0). drift_m: (k,) the
    distance of the raw position at each observation of the map from the observation's vertex.
    """

    time_ns: IntArray
    raw: FloatArray
    bent: FloatArray
    starts: IntArray
    drift_m: FloatArray

    def stretches(self, pose: FloatArray) -> list[FloatArray]:
        """`raw` or `bent` as polylines of at least two points, one for each stretch."""
        return [part for part in np.split(pose[:, :2], self.starts) if len(part) > 1]

    def at(self, time_ns: IntArray) -> FloatArray:
        """(m, 3) corrected poses at any times, interpolated linearly between the rows kept."""
        start = self.time_ns[0]
        t, q = (self.time_ns - start).astype(np.float64), (time_ns - start).astype(np.float64)
        theta = np.unwrap(self.bent[:, 2])
        return np.stack([np.interp(q, t, c) for c in (*self.bent[:, :2].T, theta)], axis=-1)


def robot_track(
    topomap: TopoMap, odometry: Odometry, *, every_row: bool = False
) -> RobotTrack | None:
    """The track of a run on its map; None without odometry or without observations to place it by.

    every_row: keep all rows of the odometry. Every unbroken stretch is placed on its own; one
    without observations is left out. O(n log k) for n poses and k observations.
    """
    if len(odometry) == 0:
        return None
    edges = pairwise([0, *odometry.cuts.tolist(), len(odometry)])
    chain = stretch_of(odometry, topomap.observation_time_ns)
    spacing = 0.0 if every_row else max(FINEST_M, float(odometry.step_m.sum()) / MOST_POINTS)
    drift_m = np.zeros(len(chain))
    parts = []
    for number, (a, b) in enumerate(edges):
        seen = np.flatnonzero(chain == number)
        if len(seen):
            stretch = Odometry(odometry.time_ns[a:b], odometry.pose[a:b], odometry.breaks[:0])
            parts.append(_placed(topomap, seen, stretch, spacing))
            drift_m[seen] = parts[-1].drift_m
    if not parts:
        return None
    return RobotTrack(
        np.concatenate([part.time_ns for part in parts]),
        np.concatenate([part.raw for part in parts]),
        np.concatenate([part.bent for part in parts]),
        np.cumsum([len(part.time_ns) for part in parts])[:-1],
        drift_m,
    )


def _placed(topomap: TopoMap, seen: IntArray, stretch: Odometry, spacing: float) -> RobotTrack:
    """The track of one unbroken stretch, placed by the observations `seen`."""
    times, vertices = topomap.observation_time_ns[seen], topomap.observation_vertex[seen]
    time_ns, first = np.unique(times, return_index=True)
    seen_at = topomap.xy[vertices[first]]
    passed = stretch.at(time_ns)
    T_map_odom = fit_rigid(seen_at, passed[:, :2])
    drift = apply(T_map_odom, stretch.at(times)[:, :2]) - topomap.xy[vertices]
    rows = thinned(stretch.pose[:, :2], spacing)
    raw = compose(T_map_odom, stretch.pose[rows])
    bent = _bent(stretch.time_ns[rows], raw, time_ns, compose(T_map_odom, passed), seen_at)
    drift_m = np.hypot(drift[:, 0], drift[:, 1])
    return RobotTrack(stretch.time_ns[rows], raw, bent, stretch.breaks, drift_m)


def _bent(
    time_ns: IntArray, raw: FloatArray, pass_ns: IntArray, passed: FloatArray, seen_at: FloatArray
) -> FloatArray:
    """Corrected poses (n, 3): between two passes the raw track is rotated by the angle between the
    raw chord and the map's, and the remaining offset at its end is distributed linearly in time.

    time_ns (n,), raw (n, 3): the track; pass_ns (k,), passed (k, 3): the raw poses at passes;
    seen_at (k, 2): their vertices.
    """
    turn = _chord_turns(passed[:, :2], seen_at)
    after = np.clip(np.searchsorted(pass_ns, time_ns, side="right"), 1, max(len(pass_ns) - 1, 1))
    before = after - 1
    if len(pass_ns) == 1:
        after = before
    T_turn = np.stack([np.zeros(len(turn)), np.zeros(len(turn)), turn], axis=-1)[before]
    span = (pass_ns[after] - pass_ns[before]).astype(np.float64)
    along = (time_ns - pass_ns[before]).astype(np.float64)
    share = np.clip(np.divide(along, span, out=np.zeros(len(along)), where=span > 0), 0.0, 1.0)
    start, end = passed[before, :2], passed[after, :2]
    rest = seen_at[after] - seen_at[before] - apply(T_turn, end - start)
    xy = seen_at[before] + apply(T_turn, raw[:, :2] - start) + share[:, None] * rest
    return np.column_stack([xy, raw[:, 2] + turn[before]])


def _chord_turns(passed: FloatArray, seen_at: FloatArray) -> FloatArray:
    """(k,) angle from the raw chord to the map's chord after each pass [rad]; where either is
    shorter than SHORT_CHORD_M, the last one before (0 if none)."""
    raw, own = np.diff(passed, axis=0), np.diff(seen_at, axis=0)
    long = np.minimum(np.hypot(*raw.T), np.hypot(*own.T)) >= SHORT_CHORD_M
    turn = np.angle((own[:, 0] + 1j * own[:, 1]) * (raw[:, 0] - 1j * raw[:, 1]))
    latest = np.maximum.accumulate(np.where(long, np.arange(len(long)), -1))
    filled = np.where(latest >= 0, turn[np.maximum(latest, 0)], 0.0)
    return np.concatenate([filled, filled[-1:] if len(filled) else [0.0]])
