"""What passes show from their first to their last third: how branches turn in the frame of the
odometry while the robot drives by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.passes import Passes
from ...topology.run import Detections
from ...topology.se2 import apply, wrap
from ...topology.topomap import RunNoise
from ...topology.track import walked_at
from ...topology.walk_means import WalkMeans
from .heading_evidence import PARTS, assign_readings, pass_at

PRIOR_MESSAGES = 20.0
"""Weight of the prior of the detector's scatter, in messages."""

SAME = 0.001
"""Readings that scatter by less, in metres or radians, are taken to repeat one another: no detector
is as exact."""


@dataclass(frozen=True, slots=True, eq=False)
class WithinPasses:
    """Differences between the first and the last third of each pass that is long enough.

    turn (q,) rotation of the branches [rad], turn_variance (q,) its variance by the detector's
    scatter; walked (q, 2) path length [m] and absolute rotation [rad] that determine the variance
    of a random walk averaged over both thirds.
    branch_sigma, centre_sigma: scatter of single messages; messages: median number in a pass.
    """

    turn: FloatArray
    turn_variance: FloatArray
    walked: FloatArray
    branch_sigma: float
    centre_sigma: float
    messages: float

    @classmethod
    def of(
        cls, odometry: Odometry, detections: Detections, passes: Passes, prior: RunNoise
    ) -> WithinPasses | None:
        """None if no message belongs to a pass. prior: of the detector's scatter."""
        if len(passes) == 0:
            return None
        message_pass, order = messages_of(detections, passes)
        rows = np.flatnonzero(message_pass >= 0)
        if len(rows) == 0:
            return None
        home, time_ns = message_pass[rows], detections.time_ns[rows]
        pose = odometry.at(time_ns)
        centre = apply(pose, detections.centre[rows])
        p = len(passes)
        n = np.bincount(home, minlength=p)
        centre_sigma = scatter(centre, home, prior.centre_m)
        readings = assign_readings(odometry, detections, passes)
        reading_message = detections.branches.owner[readings.row]
        sequence = np.lexsort((reading_message, readings.branch))
        heading = np.asarray(wrap(readings.heading - passes.branches.values[readings.branch]))
        branch_sigma = scatter(heading[sequence, None], readings.branch[sequence], prior.branch_rad)
        third = np.minimum(3 * order // np.maximum(n[message_pass], 1), 2)
        usable = np.flatnonzero(n >= PARTS)
        track = walked_at(odometry, time_ns)
        thirds = WalkMeans.of(track, 3 * home + third[rows], 3 * p)
        turn, variance = _branch_turn(readings.branch, heading, third[reading_message], passes)
        return cls(
            turn=turn[usable],
            turn_variance=branch_sigma**2 * variance[usable],
            walked=thirds.between(3 * usable, 3 * usable + 2),
            branch_sigma=branch_sigma,
            centre_sigma=centre_sigma,
            messages=float(np.median(n[n > 0])),
        )


def messages_of(detections: Detections, passes: Passes) -> tuple[IntArray, IntArray]:
    """(k,) pass of every message, -1 for none, and its index within the pass."""
    home = pass_at(passes, detections.time_ns)
    first = np.searchsorted(detections.time_ns, passes.start_ns)
    return home, np.arange(len(home)) - first[home]


def scatter(values: FloatArray, group: IntArray, prior: float) -> float:
    """Standard deviation of single readings (k, d) about their group's mean, from differences of
    successive ones.

    Differences are insensitive to slow drift, their median to outliers. Readings that are all the
    same, as those of a landmark that is tracked in the odometry's frame, do not show the noise.
    """
    same = np.diff(group) == 0
    step = np.abs(np.diff(values, axis=0)[same]).ravel()
    # Median of |N(0, 2σ²)| = 0.6745 √2 σ.
    found = float(np.median(step)) / (0.6745 * np.sqrt(2)) if len(step) else 0.0
    if found < SAME:
        return float(prior / np.sqrt(2))
    weight, expected = float(len(step)), prior**2 / 2
    total = weight + PRIOR_MESSAGES
    variance = (weight * found**2 + PRIOR_MESSAGES * expected) / total
    return float(np.sqrt(variance))


def _branch_turn(
    branch: IntArray, heading: FloatArray, third: IntArray, passes: Passes
) -> tuple[FloatArray, FloatArray]:
    """(p,) mean rotation of a pass's branches from its first to its last third, and its variance
    for unit noise.

    The variance is infinite if no branch was seen in both.
    """
    count, p = len(passes.branches.values), len(passes)
    total = np.bincount(branch * 3 + third, heading, 3 * count).reshape(-1, 3)
    size = np.bincount(branch * 3 + third, minlength=3 * count).reshape(-1, 3)
    both = (size[:, 0] > 0) & (size[:, 2] > 0)
    n0, n2 = np.maximum(size[:, 0], 1), np.maximum(size[:, 2], 1)
    weight = np.where(both, 1 / (1 / n0 + 1 / n2), 0.0)
    owner = passes.branches.owner
    sums = np.bincount(owner, weight, p)
    moved = np.bincount(owner, weight * (total[:, 2] / n2 - total[:, 0] / n0), p)
    safe = np.where(sums > 0, sums, 1.0)
    return moved / safe, np.where(sums > 0, 1 / safe, np.inf)
