"""The scans of a log as a stream of batches: validated, with the laser's pose on the robot, in
order of time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.se2 import compose, wrap, yaw_from_quaternion
from ..frames import NOWHERE_ELSE
from ..logs.clouds import Cloud
from ..logs.lasers import Geometry, RawScans, ScanIntake
from ..logs.messages import LATEST_NS, Channel, several, several_that
from ..logs.recording import Recording
from ..read_settings import Stamp
from ..topic_poses import Clock
from .scan import ScanBatch
from .slicing import DEFAULT_SLICES, FARTHEST_M, SliceSettings, sliced

MOST_FREE_M = 50.0
"""Largest distance to which a beam without an echo counts as free space."""

UNLIKELY_M = 100.0
"""A scan with more than half of its echoes beyond this is left out: it shows no junction, and
ranges in centimetres and millimetres look like this."""
FAR = (
    f"see most things beyond {UNLIKELY_M:g} m (ranges are metres; are these centimetres or "
    "millimetres?)"
)

LONGEST_SWEEP_S = 1.0
"""A longer sweep is not believed: scanners turn at 5 Hz or faster."""

MOST_LASERS = 64
"""Lasers of a topic that are told apart, to bound memory: further ones count as the last one."""

SAME_RAD = 0.5
"""Scans in one frame whose middles look in directions that differ by less are of one laser: drivers
add and drop some beams at the ends of a sweep, two lasers look far apart."""


LEVEL = 0.97
"""Cosine of the largest tilt of a laser (14°); beyond it walls and floor cannot be told apart."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """Poses of the sensors on the robot.

    known: (7,) T_body_sensor by frame; otherwise: T_body_sensor from the name of any other frame,
    None to leave such scans out. overturned: all sensors are rotated by 180° about their x axes
    against `known`.
    """

    known: Mapping[str, FloatArray] = field(default_factory=dict)
    otherwise: Callable[[str], FloatArray] | None = None

    overturned: bool = False

    def of(self, frame: str) -> FloatArray | None:
        """(7,) T_body_sensor, None if it is not known."""
        found = self.known.get(frame)
        found = self.otherwise(frame) if found is None and self.otherwise is not None else found
        return found if found is None or not self.overturned else _overturned(found)


@dataclass(slots=True)
class Tally:
    """Statistics of a stream: scans returned, and how many were left out or corrected, by
    reason."""

    messages: int = 0
    scans: int = 0
    failed: int = 0
    reason: str = ""
    left_out: Counter[str] = field(default_factory=Counter)
    mended: Counter[str] = field(default_factory=Counter)

    def warnings(self, topic: str) -> list[str]:
        """A sentence with a count for each kind of problem."""
        because = f" ({self.reason})" if self.reason else ""
        out = []
        if self.failed:
            failed = several(self.failed, "message")
            out.append(f"{topic}: {failed} could not be decoded{because}; left out")
        for counts, after in ((self.left_out, "; left out"), (self.mended, "")):
            problems = (several_that(n, "scan", why) for why, n in sorted(counts.items()))
            out += [f"{topic}: {scans}{after}" for scans in problems]
        return out


MOST_REASONS = 20
"""Limit on distinct reasons, since they hold frame names of the log, of any number."""


class _UnusableError(Exception):
    """Scans that cannot be used, with the reason as text; caught in this module."""


class ScanStream:
    """The scans of one topic; every iteration reads the log anew.

    topic: of scans or point clouds; clock: header or log time; stamp: the beam that a header stamp
    refers to (log time is that of a finished sweep). `tally` is that of the last iteration. Memory
    depends on the largest chunk of the log, not on its length.
    """

    def __init__(
        self,
        recording: Recording,
        topic: str,
        mounting: Mounting,
        *,
        clock: Clock = "header",
        stamp: Stamp = "begin",
        slices: SliceSettings = DEFAULT_SLICES,
        on_bytes: Callable[[int], None] | None = None,
    ) -> None:
        self._recording, self.topic, self._mounting = recording, topic, mounting
        self._clock, self._stamp, self._slices = clock, stamp, slices
        self._on_bytes = on_bytes
        self.tally = Tally()

    def __iter__(self) -> Iterator[ScanBatch]:
        self.tally = tally = Tally()
        lasers, last_ns = list[tuple[str, float]](), dict[int, int]()
        for raw in self._decoded():
            batch = self._batch(raw, lasers, last_ns)
            if batch is not None:
                last_ns[batch.laser] = int(batch.times_ns[-1])
                tally.scans += len(batch)
                yield batch

    def raw(self) -> Iterator[RawScans]:
        """The scans as decoded, not validated."""
        self.tally = Tally()
        yield from self._decoded()

    def _decoded(self) -> Iterator[RawScans]:
        intakes: list[ScanIntake] = []
        numbers: dict[Channel, int] = {}

        def want(channel: Channel) -> int:
            if channel.topic != self.topic:
                return -1
            if channel not in numbers:
                numbers[channel] = len(intakes)
                intakes.append(ScanIntake(channel, self._slice))
            return numbers[channel]

        for block in self._recording.blocks(want, self._on_bytes):
            yield from intakes[block.sink].take(block)
        tally = self.tally
        tally.messages = sum(intake.messages for intake in intakes)
        tally.failed = sum(intake.failed for intake in intakes)
        tally.reason = next((i.reason for i in intakes if i.reason), "")

    def _slice(self, cloud: Cloud) -> RawScans:
        mount = self._mounting.of(cloud.frame)
        return sliced(cloud, NOWHERE_ELSE if mount is None else mount, self._slices)

    def _batch(
        self, raw: RawScans, lasers: list[tuple[str, float]], last_ns: Mapping[int, int]
    ) -> ScanBatch | None:
        """The usable scans of a batch, None if there are none; lasers: see `_number`; last_ns: each
        laser's last time."""
        tally = self.tally
        try:
            T_body_laser, angles, backwards = self._placed(raw)
        except _UnusableError as error:
            tally.left_out[str(error)] += len(raw.message)
            return None
        laser = _number(raw, angles, lasers)
        after_ns = last_ns.get(laser, -1)
        sweep_s = _sweep_s(raw.geometry, len(angles))
        times_ns = self._times(raw, sweep_s)
        unstamped = (raw.stamp_ns <= 0) | (raw.stamp_ns >= LATEST_NS)
        good = np.ones(len(times_ns), bool)
        for why, bad in (
            (FAR, _far(raw)),
            ("carry no header time", unstamped & (self._clock == "header")),
            ("go back in time", times_ns < after_ns),
        ):
            if (good & bad).any():
                tally.left_out[why] += int((good & bad).sum())
            good &= ~bad
        if not good.any():
            return None
        order = np.flatnonzero(good)[np.argsort(times_ns[good], kind="stable")]
        ranges, free_m = _measured(raw, order, tally)
        return ScanBatch(
            times_ns[order],
            ranges[:, ::-1] if backwards else ranges,
            free_m,
            angles,
            T_body_laser,
            -sweep_s if backwards else sweep_s,
            laser,
        )

    def _placed(self, raw: RawScans) -> tuple[FloatArray, FloatArray, bool]:
        """T_body_laser, ascending beam directions (m,) [rad], and whether the beams were in
        descending order.

        Raises _UnusableError if the pose or the directions are unknown or invalid.
        """
        geometry = raw.geometry
        mount = self._mounting.of(geometry.frame)
        if mount is None:
            named = repr(geometry.frame[:100])
            few = len(self.tally.left_out) < MOST_REASONS
            raise _UnusableError(
                f"are in frame {named if few else '…'}, of which the log does not say where it is"
            )
        angles = _angles(raw, self.tally)
        if geometry.level:
            return np.array([mount[0], mount[1], 0.0]), angles, False
        upright = _upright(mount)
        if abs(upright) < LEVEL:
            raise _UnusableError("are of a laser that is tilted by more than 14 degrees")
        sign = 1.0 if upright > 0 else -1.0
        mounted = np.array([mount[0], mount[1], yaw_from_quaternion(*mount[3:])])
        # The frame of a laser that is upside down is mirrored when seen from above.
        T_body_laser = compose(mounted, np.array(geometry.pose) * np.array([1.0, sign, sign]))
        seen = sign * angles
        return T_body_laser, *((seen[::-1], True) if seen[0] > seen[-1] else (seen, False))

    def _times(self, raw: RawScans, sweep_s: float) -> IntArray:
        """(n,) times of the middle beams [ns]."""
        half = round(0.5e9 * sweep_s)
        if self._clock == "log":
            return raw.log_ns - half
        shift = {"begin": half, "middle": 0, "end": -half}[self._stamp]
        return raw.stamp_ns + shift


def _number(raw: RawScans, angles: FloatArray, lasers: list[tuple[str, float]]) -> int:
    """The number of the laser of these scans, from 0 on; lasers: frame and middle direction [rad]
    of those seen before, added to."""
    frame, middle = raw.geometry.frame, float(angles.mean()) + raw.geometry.pose[2]
    for number, (known, direction) in enumerate(lasers):
        if known == frame and (raw.blind or abs(wrap(middle - direction)) < SAME_RAD):
            return number
    if len(lasers) < MOST_LASERS:
        lasers.append((frame, middle))
    return len(lasers) - 1


def _angles(raw: RawScans, tally: Tally) -> FloatArray:
    """(m,) beam directions in the laser's frame [rad]; raises _UnusableError."""
    geometry, beams = raw.geometry, raw.ranges_m.shape[1]
    first, step = geometry.angle_min, geometry.angle_increment
    numbers = first, step, *geometry.pose
    if not np.isfinite(numbers).all() or max(map(abs, numbers)) > FARTHEST_M:
        raise _UnusableError("have angles that are no numbers")
    if beams < 2:
        raise _UnusableError("have fewer than two ranges")
    if step == 0 or abs(step) * (beams - 1) > 2.1 * np.pi:
        raise _UnusableError("have angles that make no turn, or more than a whole one, in radians")
    if abs((geometry.angle_max - first) / step - (beams - 1)) > 1.5:
        tally.mended[
            "hold more or fewer ranges than from angle_min to angle_max; taken by number"
        ] += len(raw.message)
    return np.asarray(first + step * np.arange(beams), np.float64)


def _overturned(mount: FloatArray) -> FloatArray:
    """(7,) T_body_sensor rotated by 180° about the sensor's x axis."""
    x, y, z, w = mount[3:]
    return np.array([*mount[:3], w, z, -y, -x])


def _upright(mount: FloatArray) -> float:
    """Cosine of the angle between the z axes of sensor and robot."""
    x, y = mount[3:5] / np.linalg.norm(mount[3:])
    return float(1 - 2 * (x * x + y * y))


def _sweep_s(geometry: Geometry, beams: int) -> float:
    """Time from the first to the last beam [s], 0 if unknown."""
    sweep = geometry.time_increment * (beams - 1)
    return float(sweep) if 0 <= sweep <= LONGEST_SWEEP_S else 0.0


def _far(raw: RawScans) -> BoolArray:
    """(n,) which scans have more than half of their echoes beyond UNLIKELY_M."""
    with np.errstate(invalid="ignore"):
        echo = (raw.ranges_m > 0) & (raw.ranges_m < np.inf)
    far = echo & (raw.ranges_m > UNLIKELY_M)
    return np.asarray(2 * far.sum(axis=1) > echo.sum(axis=1))


def _measured(raw: RawScans, rows: IntArray, tally: Tally) -> tuple[Float32Array, FloatArray]:
    """(n, m) ranges [m], NaN without an echo; (n,) distance to which such a beam counts as free
    [m].

    There is no echo if a range is at or beyond range_max, infinite, NaN, 0 or below range_min: many
    drivers write one of the latter if nothing is in reach.
    """
    ranges, g = raw.ranges_m[rows], raw.geometry
    limit = (
        g.range_max if np.isfinite(g.range_max) and g.range_max > max(g.range_min, 0) else np.inf
    )
    with np.errstate(invalid="ignore"):
        seen = (ranges > 0) & (ranges >= g.range_min) & (ranges < min(limit, FARTHEST_M))
    free_m = np.full(len(rows), 0.0 if np.isinf(limit) or raw.blind else min(limit, MOST_FREE_M))
    empty = ~seen.any(axis=1)
    if empty.any():
        tally.mended["hold no usable range"] += int(empty.sum())
    return np.where(seen, ranges, np.float32(np.nan)), free_m


class InterleavedScans:
    """The scans of several lasers in order of time; each laser's stream reads the log on its
    own."""

    def __init__(self, streams: Sequence[ScanStream]) -> None:
        self._streams = tuple(streams)

    @property
    def warnings(self) -> list[str]:
        """A sentence with a count for each kind of problem in the last iteration."""
        return [line for stream in self._streams for line in stream.tally.warnings(stream.topic)]

    @property
    def messages(self) -> int:
        """Number of messages of all lasers."""
        return sum(stream.tally.messages for stream in self._streams)

    def __iter__(self) -> Iterator[ScanBatch]:
        if len(self._streams) == 1:
            yield from self._streams[0]
            return
        sources = [iter(stream) for stream in self._streams]
        numbers: dict[tuple[int, int], int] = {}
        heads = {k: batch for k, source in enumerate(sources) if (batch := next(source, None))}
        while heads:
            first, *others = sorted(heads, key=lambda k: (int(heads[k].times_ns[0]), k))
            batch, end = heads[first], len(heads[first])
            if others:
                until = heads[others[0]].times_ns[0]
                end = max(1, int(np.searchsorted(batch.times_ns, until, side="right")))
            laser = numbers.setdefault((first, batch.laser), len(numbers))
            yield replace(batch.rows(slice(0, end)), laser=laser)
            rest = batch.rows(slice(end, None)) if end < len(batch) else None
            following = rest or next(sources[first], None)
            if following is None:
                del heads[first]
            else:
                heads[first] = following
