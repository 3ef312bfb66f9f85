"""Units, axes, frames and clocks in which detections and odometry disagree.

Every reading of the numbers (`stationary.py`) is compared to the numbers as they are by a sign test
over the drive-bys (Dixon and Mood, The statistical sign test, 1946), which needs no model of the
noise: a drive-by with wrong detections has one vote like any other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from ...topology.arrays import FloatArray
from ...topology.odometry import Odometry
from ...topology.run import Detections
from ...topology.se2 import wrap
from ..logs.fields import LENGTHS
from .stationary import AS_READ, DriveBys, Fit, Reading


@dataclass(frozen=True, slots=True)
class ConventionSettings:
    """Which lags are tried, and when a reading is told of."""

    most_lag_s: float = 10.0
    """Largest lag considered: robots are at another junction by then."""
    lag_step_s: float = 0.25
    """Step of the search for a lag: rotations of robots last longer."""
    least_lag_s: float = 0.9
    """Smaller lags are left to the calibration: three sigmas of its prior."""
    left: float = 0.67
    """A drive-by votes if one reading leaves at most this share of the other's residual (root mean
    square): as for scans that may be late (`scans/clock_lag.py`)."""
    share: float = 0.8
    """Least share of the votes for a reading that is told of: as for scans that may be mirror
    images (`scans/handedness.py`)."""
    false_rate: float = 1e-3
    """Bound on the probability that chance lets any reading of a log win the sign test."""


CONVENTIONS = ConventionSettings()

UNITS = {"mm": "millimetres", "cm": "centimetres", "in": "inches", "ft": "feet"}
"""Units of lengths that are told of (`LENGTHS`)."""
UNIT_TOLERANCE = 0.1
"""Relative error up to which a unit is named: ten sigmas of odometries in general
(`NoiseSettings.scale_prior`)."""
LEAST_SCALE = float(LENGTHS["ft"] ** -0.5)
"""Scales beyond are nearer to feet than to metres."""
LEAST_TURN_RAD = np.pi / 4
"""Frames turned by more have another axis nearer to their own."""

STAY = "stay where they were seen only if"
SEE = "see docs/detections.md"
FRAME = "the header (or frame= of --junction-fields)"

YAW = {
    -1.0: "run the other way: they are expected counter-clockwise",
    float(np.pi / 180): "are 1/57.3 of what the messages say: are they degrees taken for radians?",
    float(180 / np.pi): "are 57.3 times what the messages say: are they radians taken for degrees?",
    0.0: "are those in which it moves, not what the messages say: are they degrees taken for "
    "radians, or quaternions in another order?",
}
"""Factors on the headings of the odometry (`Reading.yaw`), and what they are then."""
HEADINGS = {
    -1: "run the other way: they are expected counter-clockwise",
    0: "do not turn against the robot: are they rounded, or in a frame fixed to the world, which "
    f"{FRAME} must name?",
}
"""Factors on the rotation of the robot by which headings of branches stay, and what they are then;
1 is expected."""
AXES = tuple(Reading(mirrored, yaw) for mirrored in (False, True) for yaw in (1.0, *YAW))
LAGS = tuple(
    Reading(lag_s=sign * CONVENTIONS.lag_step_s * (k + 1))
    for k in range(round(CONVENTIONS.most_lag_s / CONVENTIONS.lag_step_s))
    for sign in (1, -1)
)
POSES = (*AXES[1 : len(YAW) + 1], *LAGS)
"""Readings that differ in the poses of the robot alone."""
NEAR = LAGS[2:4]
"""Lags that fit worse if stamps are right: no others need to be tried then."""
TESTS = 2 * (len(AXES) + len(LAGS) + len(HEADINGS))
"""No log is asked more comparisons."""


def disagreements(
    odometry: Odometry, detections: Detections, odometry_topic: str, junction_topic: str
) -> list[str]:
    """One sentence per convention in which the detections disagree with the odometry as recorded.

    Nothing is found where the log does not tell: in less than some 20 drive-bys, of a robot that
    only drives straight (axes, headings, lags), in positions that do not move against the robot,
    and in detections given in the frame of the odometry, which stay in place however it is read.
    O(m + n log n) for m poses and n detections.
    """
    seen = DriveBys.of(odometry, detections)
    if not _significant(len(seen), 0):
        return []
    junctions, branches = (
        f"{what} of {junction_topic} {STAY}" for what in ("junctions", "branches")
    )
    read = seen.fit(AS_READ, 1.0)
    if _wins(seen.in_fixed_frame(), read.squares):
        fixed = "their positions are in a frame fixed to the world, not to the robot"
        return [f"{junctions} {fixed}: {FRAME} must name it; {SEE}"]
    fit = _better_fit(seen, read)
    if fit is not None:
        poses, sign = _headings(seen, fit.reading)
    else:
        positions_tell = _wins(read.squares, read.still)
        poses, sign = _headings(seen, AS_READ, () if positions_tell else POSES)
    told = [*_of_poses(poses, odometry_topic), *_of_positions(seen, fit, odometry_topic)]
    sentences = [f"{junctions} {what}; {SEE}" for what in told]
    if sign in HEADINGS:
        sentences.append(f"{branches} their headings {HEADINGS[sign]}; {SEE}")
    return sentences


def _better_fit(seen: DriveBys, read: Fit) -> Fit | None:
    """The centres by the reading that fits best, if it is another one and far better than as they
    were read, and tells how the robot moved."""
    plain = seen.fit(AS_READ).squares
    in_time = all(_wins(plain, seen.fit(reading).squares) for reading in NEAR)
    fits = [seen.fit(reading) for reading in (*AXES, *(() if in_time else LAGS))]
    best = min(fits, key=lambda fit: _size(fit.squares))
    found = _differs(best) and _wins(best.squares, read.squares)
    if found and best.reading in LAGS:  # junctions that are seen off by a step turn with the robot
        found = _wins(best.squares, seen.seen_from_elsewhere())
    return best if found and _wins(best.squares, best.still) else None


def _headings(
    seen: DriveBys, believed: Reading, others: Sequence[Reading] = ()
) -> tuple[Reading, int]:
    """The reading of the poses, and the factor on their rotation, by which headings of branches
    stay: `believed` and 1 unless another is far better, or `believed` is too rough to tell."""
    if abs(believed.yaw) != 1.0:
        return believed, 1
    options = [(believed, 1), *((believed, sign) for sign in HEADINGS), *((r, 1) for r in others)]
    squares = [seen.headings(*option) for option in options]
    best = int(np.argmin([_size(s) for s in squares]))
    tells = options[best][0] == believed or _differs_in_poses(options[best][0])
    return options[best if tells and _wins(squares[best], squares[0]) else 0]


def _size(squares: FloatArray) -> float:
    """How large the residuals of all drive-bys are, each by its logarithm."""
    return float(np.log(np.maximum(squares, np.finfo(float).tiny)).sum())


def _wins(squares: FloatArray, others: FloatArray) -> bool:
    """Whether residuals are far smaller than others in significantly many drive-bys."""
    less = CONVENTIONS.left**2
    return _significant(int(np.sum(squares < less * others)), int(np.sum(others < less * squares)))


def _significant(votes: int, against: int) -> bool:
    """Whether so many votes are no chance: the upper tail of the binomial distribution."""
    decided = votes + against
    if votes == 0 or votes < CONVENTIONS.share * decided:
        return False
    return float(bdtrc(votes - 1, decided, 0.5)) * TESTS <= CONVENTIONS.false_rate


def _differs(fit: Fit) -> bool:
    """Whether a fit is another reading, beyond the usual errors of sensors."""
    scaled = not 1 / LEAST_SCALE < abs(fit.slope) < LEAST_SCALE
    turned = abs(np.angle(fit.slope)) > LEAST_TURN_RAD
    return bool(fit.reading.mirrored or scaled or turned or _differs_in_poses(fit.reading))


def _differs_in_poses(reading: Reading) -> bool:
    return reading.yaw != 1.0 or abs(reading.lag_s) > CONVENTIONS.least_lag_s


def _of_poses(reading: Reading, odometry_topic: str) -> Iterator[str]:
    if reading.yaw in YAW:
        yield f"the headings of {odometry_topic} {YAW[reading.yaw]}"
    if abs(reading.lag_s) > CONVENTIONS.least_lag_s:
        late = "late" if reading.lag_s > 0 else "early"
        yield (
            f"they are stamped {abs(reading.lag_s):g} s (± {CONVENTIONS.lag_step_s:g} s) {late} "
            f"beside {odometry_topic}: --time log, or stamp= of --junction-fields, may lead to "
            "better times"
        )


def _of_positions(seen: DriveBys, fit: Fit | None, odometry_topic: str) -> Iterator[str]:
    if fit is None or abs(fit.reading.yaw) != 1.0:  # the headings are known up to a constant
        return
    if fit.reading.mirrored:
        yield (
            "the y axis of their positions points the other way: y is expected to the left of x, "
            f"here and in {odometry_topic}"
        )
    turned = float(np.angle(fit.slope))
    if abs(turned) > LEAST_TURN_RAD:
        by = f"turned by {abs(np.degrees(turned)):.0f} degrees"
        if abs(wrap(turned + seen.moves_towards(fit.reading))) < LEAST_TURN_RAD:
            yield (
                f"the headings of {odometry_topic} are {by}, as they are against the way in which "
                "it moves: mend its quaternions; or, if the robot does drive like that, the frame "
                f"of their positions is: then {FRAME} must name it"
            )
        else:
            yield (
                f"the frame of their positions is {by}: {FRAME} must name it, and /tf_static join "
                "it to the robot's"
            )
    scale = abs(fit.slope)
    if not 1 / LEAST_SCALE < scale < LEAST_SCALE:
        times = max(scale, 1 / scale)
        unit = next((u for u in UNITS if abs(np.log(times * LENGTHS[u])) < UNIT_TOLERANCE), None)
        whose, expected = f"the positions of {odometry_topic}", "metres"
        if scale > 1:
            whose = "their positions"
            expected += f", or length={unit} of --junction-fields" if unit else ""
        yield (
            f"{whose} are {1 / times:.3g} (± {100 * fit.sigma / scale:.1g} %) of what the messages "
            f"say: are they in {UNITS[unit] if unit else 'another unit'}? Expected: {expected}"
        )
