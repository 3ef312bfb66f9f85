"""Simulated odometry: the true motion with errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.se2 import between, wrap
from .chance import Chance, quantised
from .motion import Drive
from .settings import Drift


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTrack:
    """Odometry rows: time_s (n,); pose (n, 3) T_odom_base; breaks (k,): rows of resets.

    jumps: (j,) rows of jumps and sudden heading errors; true_pose: (n, 3) in the world; twist: (n,
    2) forward [m/s] and angular [rad/s] speed.
    """

    time_s: FloatArray
    pose: FloatArray
    breaks: IntArray
    jumps: IntArray
    true_pose: FloatArray
    twist: FloatArray


def measured(drive: Drive, drift: Drift, rate_hz: float, chance: Chance) -> MeasuredTrack:
    """The odometry of a drive, in its own frame. O(n), vectorised."""
    time = _stamps(float(drive.time_s[-1]), rate_hz, chance)
    period = np.diff(time)
    true = drive.at(time)
    step = between(true[:-1], true[1:])
    way, turn = np.hypot(step[:, 0], step[:, 1]), np.diff(true[:, 2])
    forward, aside = _moves(step, turn, drift, chance)
    heading = _turns(way, turn, period, drift, chance)
    jumps = _struck(way, drift.heading_jumps_per_100_m, chance)
    heading[jumps] += np.radians(chance.normal(drift.heading_jump_deg, len(jumps)))
    breaks = _struck(way, drift.resets_per_100_m, chance) + 1
    origin = _origin(chance)
    twist = np.column_stack([forward / period, heading / period])
    leapt, (ahead, left, turned) = _leaps(way, drift, chance)
    forward[leapt] += ahead
    aside[leapt] += left
    heading[leapt] += turned
    pose = _integrated(forward, aside, heading, origin, breaks)
    jumps = np.union1d(jumps, leapt) + 1
    return MeasuredTrack(time, pose, breaks, jumps, true, np.concatenate([twist, twist[-1:]]))


def _stamps(end_s: float, rate_hz: float, chance: Chance) -> FloatArray:
    """(n,) times of the odometry's messages: periodic with jitter."""
    count = int(end_s * rate_hz) + 1
    time = np.arange(count) / rate_hz
    time[1:-1] += chance.normal(0.05, count - 2) / rate_hz
    return quantised(time, 20)


def _moves(
    step: FloatArray, turn: FloatArray, drift: Drift, chance: Chance
) -> tuple[FloatArray, FloatArray]:
    """Measured motion forward and to the left in every step [m]."""
    way = np.hypot(step[:, 0], step[:, 1])
    noise = drift.along_m_per_sqrt_m * np.sqrt(way)
    scale = 1 + chance.one_normal(drift.scale_sigma)
    forward = step[:, 0] * scale + noise * chance.normal(1.0, len(way))
    aside = step[:, 1] * scale + 0.5 * noise * chance.normal(1.0, len(way))
    rolling = way > 0.2 * np.abs(turn)
    return forward, aside + drift.sideways_slip_m_per_rad * turn * rolling


def _turns(
    way: FloatArray, turn: FloatArray, period: FloatArray, drift: Drift, chance: Chance
) -> FloatArray:
    """Measured rotation in every step [rad]."""
    scaled = turn * (1 + chance.one_normal(drift.turn_scale_sigma))
    walk = drift.heading_deg_per_sqrt_m * np.sqrt(way) * chance.normal(1.0, len(way))
    per_turn = drift.heading_deg_per_sqrt_rad * np.sqrt(np.abs(turn))
    walk = walk + per_turn * chance.normal(1.0, len(way))
    bias = chance.one_normal(drift.gyro_bias_deg_per_s_sigma) * period
    return scaled + np.radians(walk + bias - drift.heading_bias_deg_per_m * way)


def _struck(way: FloatArray, per_100_m: float, chance: Chance) -> IntArray:
    """Indices of steps with an event, of constant rate along the path, without the first and last
    two."""
    hit = chance.uniform(0.0, 1.0, len(way)) < per_100_m * way / 100
    hit[:2] = hit[-2:] = False
    return np.flatnonzero(hit)


def _leaps(way: FloatArray, drift: Drift, chance: Chance) -> tuple[IntArray, FloatArray]:
    """Steps in which the odometry's frame jumps; (3, j) the jump forward, to the left [m] and in
    heading [rad]."""
    if drift.jumps == 0:
        return np.zeros(0, np.int64), np.zeros((3, 0))
    # One jump in the middle half of each of `jumps` equal parts of the path.
    share = (np.arange(drift.jumps) + 0.5 + chance.around(0.25, drift.jumps)) / drift.jumps
    row = np.unique(np.searchsorted(np.cumsum(way), share * way.sum()))
    whither = chance.around(np.pi, len(row))
    turn = np.where(chance.happens(0.5, len(row)), 1, -1) * np.radians(drift.jump_deg)
    shift = [drift.jump_m * quantised(of(whither), 26) for of in (np.cos, np.sin)]
    return row, np.stack([*shift, turn])


def _origin(chance: Chance) -> FloatArray:
    """The first pose: zero for half of the runs, random for the others."""
    if chance.one_happens(0.5):
        return np.zeros(3)
    return quantised(np.append(chance.around(30.0, 2), chance.around(np.pi, 1)), 20)


def _integrated(
    forward: FloatArray,
    aside: FloatArray,
    heading: FloatArray,
    origin: FloatArray,
    breaks: IntArray,
) -> FloatArray:
    """(n + 1, 3) poses from steps; each break restarts at zero.

    Increments are rounded to a micrometre before summing, so that sums are exact and the same on
    every machine.
    """
    n = len(forward)
    segment = np.searchsorted(breaks, np.arange(n + 1), side="right")
    first = np.concatenate([[0], breaks])
    turned = np.concatenate([[0.0], np.cumsum(quantised(heading, 26))])
    theta = turned - turned[first][segment] + np.where(segment == 0, origin[2], 0.0)
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    out = np.zeros((n + 1, 3))
    for axis, move in enumerate((c * forward - s * aside, s * forward + c * aside)):
        moved = np.concatenate([[0.0], np.cumsum(quantised(move, 20))])
        out[:, axis] = moved - moved[first][segment] + np.where(segment == 0, origin[axis], 0.0)
    out[:, 2] = wrap(theta)
    return quantised(out, 16)
