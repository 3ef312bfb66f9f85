"""How well junctions stay in place while a robot drives by, by different readings of the numbers.

A junction does not move: detections of one junction, carried into the odometry frame by the poses
at their times, coincide. In complex numbers, for a robot at t with heading θ that sees a junction m
at d,

    d e^{iθ} = β (m - t)

with β = 1. Positions in millimetres give |β| = 1000; a sensor frame turned by α, arg β = α; a y
axis to the right, conj(d) in place of d; headings in degrees taken for radians, θ times 180/π; late
stamps, t and θ of another time. Each such *reading* is a linear least-squares problem with one β
and an m for each drive-by, which is eliminated by subtracting means: odometry does not drift within
the seconds of a drive-by. The headings of branches tell θ as well: from detection to detection they
turn as the robot does, against it. That all of them are turned alike shows where the robot comes
from and goes to: by a branch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.odometry import Odometry
from ...topology.ragged import Ragged, numbered
from ...topology.run import Detections
from ...topology.se2 import wrap
from ..passes import PASSES
from .heading_evidence import PARTS


@dataclass(frozen=True, slots=True)
class DriveBySettings:
    """Which detections make a drive-by, and which of its branches are compared."""

    jump_factor: float = 3.0
    """A centre that changes by this times the 0.9 quantile of all changes is another junction's, in
    whatever unit: in simulated runs 99 % of the changes are within 1.6 times."""
    most: int = 100
    """Further drive-bys are thinned out evenly, for speed: a fifth of them is enough to decide."""
    most_detections: int = 40
    """So are further detections of one: robots stand at junctions."""
    compared_s: float = 0.4
    """Headings are compared, and directions of motion taken, over this time: robots turn by more
    than the noise of headings, and by less than half of the angle between branches."""
    within_m: float = 1.0
    """A robot that comes as near to a junction drives through it: half the width of corridors."""
    beyond_m: float = 1.5
    """Distance of the point by which it comes or goes: centres are known to a tenth of that."""
    search_s: float = 20.0
    """Time before and after the detections of a drive-by in which it gets there."""


DRIVE_BYS = DriveBySettings()


class Reading(NamedTuple):
    """A way to read the numbers: positions mirrored; headings of the odometry times `yaw`, or, with
    0, those in which its positions move; poses those of `lag_s` before the detections' stamps."""

    mirrored: bool = False
    yaw: float = 1.0
    lag_s: float = 0.0


AS_READ = Reading()


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The centres by one reading: β and its 1 sigma; and for every drive-by (k,) the sum of squared
    residuals, and the same for centres that do not move against the robot (β = 0), in squared units
    of positions."""

    reading: Reading
    slope: complex
    sigma: float
    squares: FloatArray
    still: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DriveBys:
    """Detections by drive-by, and the odometry as tables over time.

    at: (n,) time of each detection [ns from the odometry's first row]; centre: (n,) x + iy; owner:
    (n,) its drive-by; first: (k,) first row of each drive-by; branches: n rows of headings [rad];
    pairs: branches of two detections of a drive-by; clock, place, turned: (m,) time, position x +
    iy, and heading as a sum of turns, of the odometry.
    """

    at: FloatArray
    centre: ComplexArray
    owner: IntArray
    first: IntArray
    branches: Ragged
    pairs: _Pairs
    clock: FloatArray
    place: ComplexArray
    turned: FloatArray

    @classmethod
    def of(cls, odometry: Odometry, detections: Detections) -> DriveBys:
        """The drive-bys with enough detections. O(m + n log n)."""
        rows, owner = _grouped(detections)
        at = (detections.time_ns[rows] - odometry.time_ns[0]).astype(np.float64)
        east, north = detections.centre[rows].T
        branches = detections.branches.take(rows)
        return cls(
            at,
            east + 1j * north,
            owner,
            np.flatnonzero(np.diff(owner, prepend=-1)),
            branches,
            _Pairs.of_branches(at, owner, branches),
            (odometry.time_ns - odometry.time_ns[0]).astype(np.float64),
            odometry.pose[:, 0] + 1j * odometry.pose[:, 1],
            odometry.pose[0, 2] + np.cumsum(odometry.turn_rad),
        )

    def __len__(self) -> int:
        return len(self.first)

    def fit(self, reading: Reading, slope: complex | None = None) -> Fit:
        """How well the centres stay in place by a reading. slope: β; None: the one that fits best,
        as the median over the drive-bys."""
        position, heading = self._poses(reading)
        seen = self.centre.conj() if reading.mirrored else self.centre
        seen = self._centred(seen * np.exp(1j * heading))
        position = self._centred(position)
        moved, still = self._sums(np.abs(position) ** 2), self._sums(np.abs(seen) ** 2)
        along = -np.add.reduceat(position.conj() * seen, self.first)
        if slope is None:
            slope = _median_ratio(along, moved)
        squares = still - 2 * (np.conj(slope) * along).real + abs(slope) ** 2 * moved
        squares = np.maximum(squares, 0.0)  # against rounding
        per_axis = squares.sum() / (2 * len(seen))
        sigma = float(np.sqrt(per_axis / np.maximum(moved.sum(), np.finfo(float).tiny)))
        return Fit(reading, slope, sigma, squares, still)

    def seen_from_elsewhere(self) -> FloatArray:
        """(k,) sum of squared residuals of the centres as they are, if odometry and detector refer
        to different points of the robot, the step between them fitted as the median over the
        drive-bys."""
        position, heading = self._poses(AS_READ)
        turn = np.exp(1j * heading)
        centre = self._centred(self.centre * turn + position)
        turn = self._centred(turn)
        along = np.add.reduceat(turn.conj() * centre, self.first)
        step = _median_ratio(along, self._sums(np.abs(turn) ** 2))
        return self._sums(np.abs(centre - step * turn) ** 2)

    def moves_towards(self, reading: Reading) -> float:
        """The direction in which the robot moves, as seen from its heading [rad]."""
        _, heading = self._poses(reading)
        ahead = self._moved(self.at - 1e9 * reading.lag_s) * np.exp(-1j * heading)
        return float(np.arctan2(np.median(ahead.imag), np.median(ahead.real)))

    def in_fixed_frame(self) -> FloatArray:
        """(k,) sum of squared residuals if centres are in a frame fixed to the world; infinite if
        they do not differ from drive-by to drive-by as the robot's positions do."""
        stay = self.unmoved()
        place, robot = self._means(self.centre), self._means(self._poses(AS_READ)[0])
        apart, driven = (np.median(np.abs(np.diff(means))) for means in (place, robot))
        return stay if 2 * apart > driven else np.full(len(self), np.inf)

    def unmoved(self) -> FloatArray:
        """(k,) sum of squared residuals of the centres' numbers, whatever their frame."""
        return self._sums(np.abs(self._centred(self.centre)) ** 2)

    def headings(self, reading: Reading, sign: int = 1) -> FloatArray:
        """(k,) sum of squared changes [rad²] of the headings of branches that turn against the
        robot (sign 1), with it (-1), or not at all (0)."""
        change = self.pairs.changes(sign * self._poses(reading)[1])
        return np.asarray(np.bincount(self.owner[self.pairs.row], change**2, len(self)))

    def off_the_way(self, turns_rad: FloatArray) -> FloatArray:
        """(t, k) sum of squared angles [rad²] between the ways by which the robot comes to a
        junction and goes, and the nearest branches, if all branches are turned by each of (t,)
        angles. 0 for drive-bys that do not lead through the junction."""
        drive_by, way = self._ways()
        count = np.diff(self.first, append=len(self.owner))
        entry, nth = numbered(count[drive_by])
        row = self.first[drive_by[entry]] + nth
        seen = self.branches.counts[row] > 0
        entry, row = entry[seen], row[seen]
        beside = self.branches.take(row)
        of = beside.owner
        off = wrap(beside.values + self._poses(AS_READ)[1][row[of]] - way[entry[of]])
        if len(off) == 0:
            return np.zeros((len(turns_rad), len(self)))
        away = np.abs(wrap(off + turns_rad[:, None]))
        nearest = np.minimum.reduceat(away, beside.offsets[:-1], axis=1)
        squares = np.minimum(nearest, LIKELIHOOD.branch_gate_rad) ** 2
        return np.array([np.bincount(drive_by[entry], s, len(self)) for s in squares])

    def _ways(self) -> tuple[IntArray, FloatArray]:
        """Drive-bys, twice each, and the directions from the junction to where the robot came from
        and to where it went [rad]."""
        position, heading = self._poses(AS_READ)
        centre = self._means(self.centre * np.exp(1j * heading) + position)
        found = []
        search = 1e9 * DRIVE_BYS.search_s
        ends = np.append(self.first[1:], len(self.owner)) - 1
        for k, (begin, end) in enumerate(zip(self.at[self.first], self.at[ends], strict=True)):
            a, b = np.searchsorted(self.clock, [begin - search, end + search])
            away = self.place[a:b] - centre[k]
            if len(away) == 0:
                continue
            nearest = int(np.abs(away).argmin())
            beyond = np.flatnonzero(np.abs(away) >= DRIVE_BYS.beyond_m)
            at = int(np.searchsorted(beyond, nearest))
            if abs(away[nearest]) <= DRIVE_BYS.within_m and 0 < at < len(beyond):
                found += [(k, away[beyond[at - 1]]), (k, away[beyond[at]])]
        drive_by = np.array([k for k, _ in found], np.int64)
        return drive_by, np.angle(np.array([way for _, way in found], np.complex128))

    def _poses(self, reading: Reading) -> tuple[ComplexArray, FloatArray]:
        """Position and heading of the robot at each detection."""
        at = self.at - 1e9 * reading.lag_s
        if reading.yaw:
            return self._positions(at), reading.yaw * np.interp(at, self.clock, self.turned)
        return self._positions(at), np.angle(self._moved(at))

    def _moved(self, at: FloatArray) -> ComplexArray:
        """How far the robot moves in `compared_s` about times (k,)."""
        half = 0.5e9 * DRIVE_BYS.compared_s
        return np.asarray(self._positions(at + half) - self._positions(at - half))

    def _positions(self, at: FloatArray) -> ComplexArray:
        return np.asarray(np.interp(at, self.clock, self.place))

    def _sums(self, values: FloatArray) -> FloatArray:
        """(k,) sum over each drive-by of values (n,) of detections."""
        return np.add.reduceat(values, self.first)

    def _means(self, values: ComplexArray) -> ComplexArray:
        sums = np.add.reduceat(values, self.first)
        return np.asarray(sums / np.diff(self.first, append=len(self.owner)))

    def _centred(self, values: ComplexArray) -> ComplexArray:
        """(n,) values less the mean of their drive-by."""
        return np.asarray(values - self._means(values)[self.owner])


def _grouped(detections: Detections) -> tuple[IntArray, IntArray]:
    """Rows of the detections in drive-bys, and the number of the drive-by of each. A silence ends a
    drive-by as it ends a pass; short ones are left out, as where drift is measured."""
    step = np.hypot(*np.diff(detections.centre, axis=0).T)
    ends = np.diff(detections.time_ns) > PASSES.gap_s * 1e9
    if not ends.all():
        ends |= step > DRIVE_BYS.jump_factor * np.quantile(step[~ends], 0.9)
    count = np.diff(np.flatnonzero(ends), prepend=-1, append=len(detections) - 1)
    large = count >= PARTS
    number = np.cumsum(large) - 1
    stride = max(1, -(-int(large.sum()) // DRIVE_BYS.most))
    owner, nth = numbered(count)
    kept = large[owner] & (number[owner] % stride == 0)
    kept &= nth % -(-count // DRIVE_BYS.most_detections)[owner] == 0
    return np.flatnonzero(kept), number[owner[kept]] // stride


def _median_ratio(over: ComplexArray, under: FloatArray) -> complex:
    """The weighted median of over / under, by parts; 0 if all of `under` is 0."""
    moved = under > 0
    if not moved.any():
        return 0j
    ratio, weight = over[moved] / under[moved], under[moved]

    def median(values: FloatArray) -> float:
        order = np.argsort(values)
        below = np.cumsum(weight[order])
        return float(values[order[np.searchsorted(below, 0.5 * below[-1])]])

    return complex(median(ratio.real), median(ratio.imag))


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Readings of branches beside all those of a later detection of the same drive-by.

    row, later: (q,) rows of the two detections of a reading; turns: q rows of differences of
    headings to the later ones [rad]; of: (c,) reading of each difference.
    """

    row: IntArray
    later: IntArray
    turns: Ragged
    of: IntArray

    @classmethod
    def of_branches(cls, at: FloatArray, owner: IntArray, branches: Ragged) -> _Pairs:
        """The readings of every detection beside the first one `compared_s` later."""
        last = np.searchsorted(owner, owner, side="right") - 1
        later = np.minimum(np.searchsorted(at, at + 1e9 * DRIVE_BYS.compared_s), last)
        row = branches.owner
        row_later = later[row]
        paired = (row_later > row) & (branches.counts[row_later] > 0)
        reading = np.flatnonzero(paired)
        row, row_later = row[reading], row_later[reading]
        beside = branches.take(row_later)
        turn = beside.values - branches.values[reading[beside.owner]]
        return cls(row, row_later, Ragged(beside.offsets, turn), beside.owner)

    def changes(self, heading: FloatArray) -> FloatArray:
        """(q,) change of the nearest heading [rad] if the robot's are (n,), clipped."""
        if len(self.row) == 0:
            return np.zeros(0)
        turned = (heading[self.later] - heading[self.row])[self.of]
        change = np.minimum.reduceat(
            np.abs(wrap(self.turns.values + turned)), self.turns.offsets[:-1]
        )
        return np.minimum(change, LIKELIHOOD.branch_gate_rad)
