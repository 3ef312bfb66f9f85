"""Units, axes, frames and clocks in which detections and odometry disagree.

Every reading of the numbers (`stationary.py`) is compared to the numbers as they are by a sign test
over the drive-bys (Dixon and Mood, The statistical sign test, 1946), which needs no model of the
noise: a drive-by with wrong detections has one vote like any other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.odometry import Odometry
from ...topology.run import Detections
from ...topology.se2 import apply, wrap
from ..logs.fields import LENGTHS
from ..topic_poses import LAG_STEP_S, LEFT, MOST_LAG_S, SAME_SHARE
from .calibration import CALIBRATION
from .stationary import AS_READ, DriveBys, Fit, Reading


@dataclass(frozen=True, slots=True)
class ConventionSettings:
    """When a reading is reported. A drive-by votes if one reading leaves at most `LEFT` of the
    other's residual (root mean square)."""

    half: float = 0.5
    """If it leaves at most this share, the vote counts as one that chance gives more rarely."""
    half_chance: float = 0.05
    """Bound on the probability that a wrong reading gets such a vote, where either does: none of
    230,000 in 90 simulated logs. Short logs decide by such votes: five suffice."""

    false_rate: float = 1e-3
    """Bound on the probability that chance lets any reading of a log win the sign test."""


CONVENTIONS = ConventionSettings()

LEAST_LAG_S = CALIBRATION.apply_at_z * CALIBRATION.prior_lag_s
"""Smaller lags are left to the calibration, as its prior holds them possible."""

UNITS = {"mm": "millimetres", "cm": "centimetres", "in": "inches", "ft": "feet"}
"""Units of lengths that are reported (`LENGTHS`)."""
UNIT_TOLERANCE = 0.1
"""Relative error up to which a unit is named: twenty sigmas of odometries in general
(`RunNoise.scale`)."""
LEAST_SCALE = float(LENGTHS["ft"] ** -0.5)
"""Scales beyond are nearer to feet than to metres."""
LEAST_TURN_RAD = np.pi / 4
"""Frames turned by more have another axis nearer to their own."""

TURNS_RAD = np.radians(np.arange(0, 360, 15))
"""Angles by which all branches may be turned, the first one none: nearer to one of these than
headings of corridors are known."""

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
    Reading(lag_s=sign * LAG_STEP_S * (k + 1))
    for k in range(round(MOST_LAG_S / LAG_STEP_S))
    for sign in (1, -1)
)
POSES = (*AXES[1 : len(YAW) + 1], *LAGS)
"""Readings that differ in the poses of the robot alone."""
TESTS = 2 * (len(AXES) + len(LAGS) + len(HEADINGS) + len(TURNS_RAD))
"""No log is asked more comparisons."""


def disagreements(
    odometry: Odometry, detections: Detections, odometry_topic: str, junction_topic: str
) -> list[str]:
    """One sentence per convention in which the detections disagree with the odometry as recorded.

    Nothing is found where the log does not tell: in less than five drive-bys, some 20 where the
    readings differ little, of a robot that only drives straight (axes, headings, lags), in
    positions that do not move against the robot, and in detections given in the frame of the
    odometry, which stay in place however it is read. O(m + n log n) for m poses and n detections.
    """
    seen = DriveBys.of(odometry, detections)
    if not _significant(len(seen), 0, CONVENTIONS.half_chance):
        return []
    junctions, branches = (
        f"{what} of {junction_topic} {STAY}" for what in ("junctions", "branches")
    )
    read = seen.fit(AS_READ, 1.0)
    if _in_robots_frame(odometry, detections):
        frame = "their positions are in the robot's frame, not in the odometry's"
        return [f"{junctions} {frame}: {FRAME} must say so; {SEE}"]
    if _wins(seen.in_fixed_frame(), read.squares):
        fixed = "their positions are in a frame fixed to the world, not to the robot"
        return [f"{junctions} {fixed}: {FRAME} must name it; {SEE}"]
    fit = _better_fit(seen, read)
    positions_tell = fit is None and _wins(read.squares, read.still)
    if fit is not None:
        poses, sign = _headings(seen, fit.reading)
    else:
        poses, sign = _headings(seen, AS_READ, () if positions_tell else POSES)
    findings = [
        *_pose_findings(poses, odometry_topic),
        *_position_findings(seen, fit, odometry_topic),
    ]
    sentences = [f"{junctions} {what}; {SEE}" for what in findings]
    if sign in HEADINGS:
        sentences.append(f"{branches} their headings {HEADINGS[sign]}; {SEE}")
    if not sentences and positions_tell:
        sentences += _turned_branches(seen, junction_topic)
    return sentences


def _turned_branches(seen: DriveBys, junction_topic: str) -> Iterator[str]:
    """One sentence, if branches all turned by one angle fit the robot's motion far better."""
    squares = seen.off_the_way(TURNS_RAD)
    best = int(np.argmin([_size(s) for s in squares]))
    if _wins(squares[best], squares[0]):
        by = f"{abs(np.degrees(wrap(TURNS_RAD[best]))):.0f} degrees"
        yield (
            f"the robot comes and goes by branches of {junction_topic} only if they are all turned "
            f"by {by}: a heading is expected to be that in which a branch leaves the junction, in "
            f"the frame of {FRAME}; {SEE}"
        )


def _in_robots_frame(odometry: Odometry, detections: Detections) -> bool:
    """Whether centres stay in place if they are seen from the robot once more: then they were in
    its frame, and their header claimed the odometry's, out of which they were taken."""
    recorded = apply(odometry.at(detections.time_ns), detections.centre)
    seen = DriveBys.of(odometry, replace(detections, centre=recorded))
    return len(seen) > 0 and _wins(seen.fit(AS_READ, 1.0).squares, seen.unmoved())


def _better_fit(seen: DriveBys, read: Fit) -> Fit | None:
    """The centres by the reading that fits best, if it is another one and far better than as they
    were read, and tells how the robot moved."""
    fits = (seen.fit(reading) for reading in (*AXES, *LAGS))
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
    """Whether `squares` are far smaller than `others` in significantly many drive-bys (sign test).
    Both: (k,) sum of squared residuals of each drive-by."""
    kinds = (LEFT, 0.5), (CONVENTIONS.half, CONVENTIONS.half_chance)
    return any(
        _significant(
            int(np.sum(squares < left**2 * others)), int(np.sum(others < left**2 * squares)), chance
        )
        for left, chance in kinds
    )


def _significant(votes: int, against: int, chance: float) -> bool:
    """Whether so many votes are no chance, which gives each with that probability: the upper tail
    of the binomial distribution."""
    from scipy.special import bdtrc  # which takes a third of a second to load

    decided = votes + against
    if votes == 0 or votes < SAME_SHARE * decided:
        return False
    return float(bdtrc(votes - 1, decided, chance)) * TESTS <= CONVENTIONS.false_rate


def _differs(fit: Fit) -> bool:
    """Whether a fit is another reading, beyond the usual errors of sensors."""
    scaled = not 1 / LEAST_SCALE < abs(fit.slope) < LEAST_SCALE
    turned = abs(np.angle(fit.slope)) > LEAST_TURN_RAD
    return bool(fit.reading.mirrored or scaled or turned or _differs_in_poses(fit.reading))


def _differs_in_poses(reading: Reading) -> bool:
    return reading.yaw != 1.0 or abs(reading.lag_s) > LEAST_LAG_S


def _pose_findings(reading: Reading, odometry_topic: str) -> Iterator[str]:
    if reading.yaw in YAW:
        yield f"the headings of {odometry_topic} {YAW[reading.yaw]}"
    if abs(reading.lag_s) > LEAST_LAG_S:
        late = "late" if reading.lag_s > 0 else "early"
        yield (
            f"they are stamped {abs(reading.lag_s):g} s (± {LAG_STEP_S:g} s) {late} "
            f"beside {odometry_topic}: --time log, or stamp= of --junction-fields, may lead to "
            "better times"
        )


def _position_findings(seen: DriveBys, fit: Fit | None, odometry_topic: str) -> Iterator[str]:
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
