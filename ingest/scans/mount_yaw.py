"""Yaw of a laser whose mounting the log does not state, from its own motion and the odometry's.

On straight drives, a laser moves in its own frame as the robot does in its, rotated by the
mounting; its position on the robot does not matter (the rotational part of hand-eye calibration:
Censi, Franchi, Marchionni and Oriolo, Simultaneous calibration of odometry and sensor parameters
for mobile robots, 2013). Each scan is matched to the one before without using the odometry.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.odometry import Odometry
from ...topology.se2 import wrap
from .alignment import ALIGNMENT, Steps, match_steps
from .association import Swept
from .keyframes import KEYFRAMES, Keyframes, keyframes
from .matching import posed
from .scan import ScanBatch
from .step_errors import LOOSE_M, odometry_motion
from .turns import TURN_RAD

ENOUGH = 40
"""Number of straight steps: their directions scatter by some degrees, their mean by one."""
MOST_SCANS = 4000
"""Largest number of scans read."""

SAME_RAD, SAME_SHARE = 0.2, 0.8
"""Tolerance of directions, and the share of them that must agree: wrongly matched scans have
arbitrary ones."""


def mount_yaw(odometry: Odometry, batches: Iterable[ScanBatch]) -> float | None:
    """The yaw [rad] of a laser in the robot's frame; None if it is uncertain.

    batches: of one laser, taken to be mounted at the robot's centre. Reads as few as needed.
    """
    found = np.zeros(0)
    for frames in keyframes(posed(odometry, _first(batches))):
        found = np.concatenate([found, _yaws(frames)])
        if len(found) >= ENOUGH:
            return _agreed(found)
    return None


def _first(batches: Iterable[ScanBatch]) -> Iterator[ScanBatch]:
    """The first batches, until they hold `MOST_SCANS` scans."""
    scans = 0
    for batch in batches:
        yield batch
        scans += len(batch)
        if scans >= MOST_SCANS:
            return


def _yaws(frames: Keyframes) -> FloatArray:
    """The yaw by every straight step of a part that is determined by its scans [rad]."""
    second = np.arange(len(frames) - 1)
    own = odometry_motion(frames, second + 1, second)
    way = np.hypot(own[:, 0], own[:, 1])
    # With a laser 0.5 m off the centre, it is moved sideways by less than a tenth of the step.
    straight = (np.abs(own[:, 2]) < TURN_RAD) & (np.diff(frames.piece) == 0)
    straight &= (way > 0.5 * KEYFRAMES.step_m) & (way < 2 * KEYFRAMES.step_m)
    second, own, way = second[straight], own[straight], way[straight]
    if len(second) == 0:
        return np.zeros(0)
    scans = Swept.of(frames)
    anywhere = np.tile(np.diag(1 / np.array([1.0, 1.0, TURN_RAD]) ** 2), (len(own), 1, 1))
    still = Steps(np.zeros_like(own), anywhere)
    seen = match_steps(scans, (second + 1, second), still)
    x, y = seen.motion[:, :2].T
    sure = (seen.fit > ALIGNMENT.lost_fit) & (seen.loose_m < LOOSE_M) & ~seen.searched
    sure &= np.abs(np.hypot(x, y) - way) < SAME_RAD * way
    return np.asarray(wrap(np.arctan2(own[:, 1], own[:, 0]) - np.arctan2(y, x))[sure])


def _agreed(yaws: FloatArray) -> float | None:
    near = np.abs(wrap(yaws[:, None] - yaws)) < SAME_RAD
    middle = int(near.sum(axis=1).argmax())
    best = near[middle]
    if best.mean() < SAME_SHARE:
        return None
    off = wrap(yaws[best] - yaws[middle])
    return float(wrap(yaws[middle] + off.mean()))
