"""Loops closed by views: where a run saw again what it had seen before.

In rounds like full closure (`incremental.py`), the most certain first. Pairs of views that position
allows are registered. What agrees beyond what other places of the run do becomes a loop, and the
track is optimised again; its smaller uncertainty admits more pairs. A loop must lead every other
one that its places offer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import joined, take
from ..matching.likelihood import LIKELIHOOD
from ..matching.views import (
    TURN_RAD,
    Registered,
    ViewIndex,
    ViewNull,
    coarse_fit,
    register,
)
from ..ragged import numbered
from ..se2 import between, compose, inverse, turned_axes, wrap
from .candidates import pairs_within
from .dead_reckoning import DeadReckoning, Factors, dead_reckoning_covariance
from .estimate import Estimate, optimise
from .evidence import EVIDENCE
from .incremental import needed_odds


@dataclass(frozen=True, slots=True)
class ViewLoopSettings:
    """Which views are compared, and when they are one place."""

    apart_m: float = 24.0
    """Views nearer to each other along the way share scans: a view is made of 10 m before and after
    its place."""
    reach_m: float = 2.0
    """Views farther apart than this hardly overlap enough to be compared."""
    doubt: float = 2.0
    """Factor on the noise of dead reckoning before the first loop: in one of five buildings the
    noise was believed half as large as it was."""
    gate_chi2: float = 6.0
    """Squared distance in these sigmas, 95 %, beyond which a pair is not registered: where copies
    abound, a place that is hardly possible is a copy."""
    tests: int = 12
    """Pairs per view that are registered at most, which bounds the time."""
    nulls: int = 300
    """Pairs of places that position keeps apart, registered to learn what they look like."""
    copies: int = 4
    """Of all views, one per `cell_m` of way, so many that fit a view best are registered with it,
    to find copies of its place."""
    references: int = 60
    """Of so many at most, spread over the run, to bound the time."""
    pairs: int = 30_000
    """Pairs of views, the nearest to each other, among which those to register are chosen: 50
    MB."""
    place_m2: float = 50.0
    """Area that one place stands for: another one may be anywhere else."""
    cell_m: float = 8.0
    """Views of places nearer than this to each other are not independent: they count once."""
    beside_m: float = 30.0
    """Way along which loops support each other."""
    known_m: float = 0.15
    """Pairs whose relative position is known to this (1 sigma) are not registered: they would be
    known little better."""
    sigma_m: float = 0.07
    sigma_rad: float = 0.01
    """1 sigma of a registration, beyond what its walls leave open: median errors against the true
    tracks of four buildings are .09 to .19 m, those of the truth included, and .02 rad."""


VIEW_LOOPS = ViewLoopSettings()


LEAST_TURN_RAD = 0.1
"""Turns are searched by this much beyond three sigmas, as the noise may be believed too small; a
registration along a bare corridor is known no better, and turns that agree differ by no more."""
DRIFT_PER_M = 0.02
"""Metres per metre of way by which two registrations may disagree, beside `gate_m`: a little less
than odometry in general drifts within `beside_m` (.03, by headings that err by .009 rad per √m)."""
TURNS = np.array([2, 4, 8, 18, 36])
"""Steps of the raster of turns to either side that are searched."""


@dataclass(frozen=True, slots=True, eq=False)
class _Tested:
    """Pairs of views that were registered: their rows (k,) each, and columns of `Registered`."""

    first: IntArray
    second: IntArray
    transform: FloatArray
    z: FloatArray
    information: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    def and_(self, first: IntArray, second: IntArray, found: Registered) -> _Tested:
        """These pairs and more."""
        more = _Tested(first, second, found.transform, found.z, found.information)
        return joined([self, more])


_NO_ROWS = np.zeros(0, np.int64)
_NONE_TESTED = _Tested(_NO_ROWS, _NO_ROWS, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3, 3)))


def view_loops(
    reckoning: DeadReckoning,
    views: ViewIndex,
    way: FloatArray,
) -> tuple[DeadReckoning, Estimate]:
    """The reckoning with its loops, and the estimate of its poses with these.

    reckoning: of the views' places, whose passes have no branches; way: (n,) distance driven [m].
    """
    return _Search(reckoning, views, way).run()


class _Search:
    """The state of a search for loops."""

    def __init__(
        self,
        reckoning: DeadReckoning,
        views: ViewIndex,
        way: FloatArray,
    ) -> None:
        self._views, self._way = views, way
        self._given = reckoning
        self._place = np.arange(len(reckoning), dtype=np.int64)
        self._tested = self._elsewhere = _NONE_TESTED
        self._kept = self._looked = _NO_ROWS
        self._blocked: set[int] = set()
        self._estimate = optimise(reckoning, self._place)
        self._different = np.zeros(0)

    def run(self) -> tuple[DeadReckoning, Estimate]:
        """Register the pairs most likely to be of one place, and close the loops that are certain
        by then, until nothing more is found or as many as `tests` allows were registered."""
        left = VIEW_LOOPS.tests * len(self._given)
        if left:
            self._learn()
        while left > 0:
            tested = self._test(max(left // 4, len(self._given)))
            left -= tested
            if not self._close() and not tested:
                break
        return self._with_loops(), self._estimate

    def _untested(self) -> tuple[IntArray, IntArray]:
        """Pairs of views that may be of one place and were not registered yet, the nearest."""
        xy, way, piece = self._estimate.pose[:, :2], self._way, self._given.piece
        i, j = pairs_within(xy, float(np.ptp(xy, axis=0).sum()), VIEW_LOOPS.pairs).T
        fine = (way[j] - way[i] >= VIEW_LOOPS.apart_m) & (piece[i] == piece[j])
        known = self._tested.first * len(xy) + self._tested.second
        fine &= ~np.isin(i * len(xy) + j, known)
        return i[fine], j[fine]

    def _relative(self, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3) poses of views j in the frames of views i as far as is known, and their covariance
        (k, 3, 3): before the first loop, that of dead reckoning with some doubt."""
        shift = between(self._estimate.pose[i], self._estimate.pose[j])
        if not len(self._kept):
            doubt = VIEW_LOOPS.doubt**2
            return shift, dead_reckoning_covariance(self._given, i, j) * doubt
        return shift, self._estimate.relative_covariance(i, j)

    def _learn(self) -> None:
        """Register pairs of places that position keeps apart, drawn from the whole run: what they
        reach is the null model."""
        drawn = np.random.default_rng(0).integers(0, len(self._given), (20 * VIEW_LOOPS.nulls, 2))
        i, j = np.unique(np.sort(drawn, axis=1), axis=0).T
        fine = self._way[j] - self._way[i] >= VIEW_LOOPS.apart_m
        fine &= self._given.piece[i] == self._given.piece[j]
        i, j = i[fine], j[fine]
        shift, cov = self._relative(i, j)
        rows = np.flatnonzero(self._apart(shift, cov))
        rows = rows[:: max(len(rows) // VIEW_LOOPS.nulls, 1)]
        nothing = np.zeros((len(rows), 3))
        nothing[:, 2] = shift[rows, 2]
        self._different = self._registered(i[rows], j[rows], nothing, cov[rows, 2, 2]).z

    def _look_elsewhere(self, rows: IntArray) -> None:
        """Register views with those of the run that they fit best, one per cell of the way."""
        rows = np.setdiff1d(rows, self._looked)
        self._looked = np.union1d(self._looked, rows)
        cell = np.floor(self._way / VIEW_LOOPS.cell_m)
        others = np.flatnonzero(np.diff(cell, prepend=-1) > 0)
        others = others[:: -(-len(others) // VIEW_LOOPS.references)]
        i, j = (x.ravel() for x in np.meshgrid(rows, others, indexing="ij"))
        fine = np.abs(self._way[i] - self._way[j]) > VIEW_LOOPS.cell_m
        fine &= self._given.piece[i] == self._given.piece[j]
        i, j = i[fine], j[fine]
        turn = wrap(self._estimate.pose[j, 2] - self._estimate.pose[i, 2])
        turns = turn[:, None] + np.arange(-1, 2) * TURN_RAD
        reach_m = 0.5 * VIEW_LOOPS.cell_m
        fit = coarse_fit(self._views, i, j, turns, reach_m)
        order = np.lexsort((-fit, i))
        nth = np.arange(len(i)) - np.searchsorted(i[order], i[order])
        best = order[nth < VIEW_LOOPS.copies]
        i, j = i[best], j[best]
        found = register(self._views, self._views, i, j, turns[best], reach_m=reach_m)
        self._elsewhere = self._elsewhere.and_(i, j, found)

    def _copied(self, null: ViewNull) -> FloatArray:
        """(k,) what the views of each tested pair reach with copies of their places, which lie
        certainly elsewhere and agree along the way, too; -inf where there are none."""
        t, e = self._tested, self._elsewhere
        own = null.odds(e.z)
        likely = np.flatnonzero(own > 0)
        copies = likely[self._support(e, likely, own) > 0]
        level = np.full(len(t), -np.inf)
        for here, there in ((t.first, t.second), (t.second, t.first)):
            # Copies of this side are rivals if they are apart from the other side.
            pair, copy = _within(here, e.first[copies], 0.0)
            other, place = there[pair], e.second[copies[copy]]
            apart = np.flatnonzero(other != place)
            low, high = np.minimum(other, place)[apart], np.maximum(other, place)[apart]
            apart = apart[self._apart(*self._relative(low, high))]
            np.maximum.at(level, pair[apart], e.z[copies[copy[apart]]])
        return level

    def _apart(self, shift: FloatArray, cov: FloatArray) -> BoolArray:
        """(k,) whether position certainly keeps pairs apart."""
        sigma = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1])
        least = np.sqrt(VIEW_LOOPS.gate_chi2) * sigma + 2 * VIEW_LOOPS.reach_m
        return np.asarray(np.hypot(shift[:, 0], shift[:, 1]) > least)

    def _test(self, most: int) -> int:
        """Register the pairs most likely to be of one place; their number."""
        i, j = self._untested()
        shift, cov = self._relative(i, j)
        reach2 = VIEW_LOOPS.reach_m**2
        open_ = 0.5 * (cov[:, 0, 0] + cov[:, 1, 1])
        variance = open_ + 0.25 * reach2
        near2 = shift[:, 0] ** 2 + shift[:, 1] ** 2
        odds = -0.5 * near2 / variance - np.log(variance)
        near = near2 < VIEW_LOOPS.gate_chi2 * variance
        rows = np.flatnonzero(near & (open_ > 0.5 * VIEW_LOOPS.known_m**2))
        rows = rows[np.argsort(-odds[rows], kind="stable")[:most]]
        if len(rows):
            i, j, expected = i[rows], j[rows], shift[rows].copy()
            # If they are of one place, they are near to each other, wherever they are expected.
            expected[:, :2] *= (reach2 / (reach2 + open_[rows]))[:, None]
            found = self._registered(i, j, expected, cov[rows, 2, 2])
            self._tested = self._tested.and_(i, j, found)
        return len(rows)

    def _registered(
        self, i: IntArray, j: IntArray, expected: FloatArray, turn_variance: FloatArray
    ) -> Registered:
        """Register views j (k,) with views i around the expected poses (k, 3), with turns as well
        known as `turn_variance` (k,) says."""
        half = np.ceil((LEAST_TURN_RAD + 3 * np.sqrt(turn_variance)) / TURN_RAD)
        # Pairs whose turns are known about as well are registered at once.
        wide = TURNS[np.minimum(np.searchsorted(TURNS, half), len(TURNS) - 1)]
        rows, parts = [], []
        for some in TURNS.tolist():
            own = np.flatnonzero(wide == some)
            turns = expected[own, 2:] + np.arange(-some, some + 1) * TURN_RAD
            rows.append(own)
            parts.append(
                register(
                    *(self._views, self._views, i[own], j[own], turns),
                    reach_m=VIEW_LOOPS.reach_m,
                    centre=expected[own, :2],
                )
            )
        return take(joined(parts), np.argsort(np.concatenate(rows)))

    def _close(self) -> bool:
        """Accept the loops that are certain by now, lay the track out again, and take those back
        that do not fit it; whether there were any."""
        new = self._certain()
        if not len(new):
            return False
        self._kept = np.union1d(self._kept, new)
        self._optimise()
        bad = self._estimate.loop_chi2 > LIKELIHOOD.gate_chi2(3)
        if bad.any():
            self._blocked |= set(self._kept[bad].tolist())
            self._kept = self._kept[~bad]
            self._optimise()
        return True

    def _certain(self) -> IntArray:
        """Rows of the tested pairs that are certainly of one place and lead all their rivals: by
        their walls, against other places and copies of their own, by the pairs beside them, and by
        position."""
        t = self._tested
        null = ViewNull.of(self._different, t.z[self._kept])
        own = null.odds(t.z)
        self._look_elsewhere(np.unique([t.first[own > 0], t.second[own > 0]]))
        own = null.odds(t.z, self._copied(null))
        open_ = np.setdiff1d(np.flatnonzero(own > 0), [*self._kept, *self._blocked])
        if not len(open_):
            return open_
        total = own.copy()
        total[open_] += self._support(t, open_, own)
        expected = self._relative(t.first[open_], t.second[open_])
        total[open_] += self._position(t.transform[open_], *expected)
        likely = open_[total[open_] >= needed_odds(len(self._given))]
        leading: IntArray = likely[self._leads(likely, total)]
        return leading

    def _position(self, transform: FloatArray, shift: FloatArray, cov: FloatArray) -> FloatArray:
        """(k,) log odds [nats] of transforms by position: density where they are expected, against
        anywhere."""
        off = (transform - shift)[:, :2]
        s = cov[:, :2, :2] + VIEW_LOOPS.sigma_m**2 * np.eye(2)
        d2 = np.einsum("ki,kij,kj->k", off, np.linalg.inv(s), off)
        vague = 2 * np.pi * np.sqrt(np.linalg.det(s))
        odds = np.log(VIEW_LOOPS.place_m2 / vague) - 0.5 * d2
        return np.asarray(np.minimum(odds, EVIDENCE.lead))

    def _support(self, t: _Tested, rows: IntArray, own: FloatArray) -> FloatArray:
        """(k,) evidence [nats] of the pairs beside each of those in `rows` that agree with it, one
        value per cell of the way. own: of each pair by its walls."""
        way = self._way
        good = np.flatnonzero(own > 0)
        row, column = _within(way[t.first[rows]], way[t.first[good]], VIEW_LOOPS.beside_m)
        gone_i = way[t.first[good[column]]] - way[t.first[rows[row]]]
        gone_j = way[t.second[good[column]]] - way[t.second[rows[row]]]
        # Both sides have to be other places.
        least = np.minimum(np.abs(gone_i), np.abs(gone_j))
        beside = (least > 0.5 * VIEW_LOOPS.cell_m) & (np.abs(gone_j) < VIEW_LOOPS.beside_m)
        row, column, gone_i, gone_j = row[beside], column[beside], gone_i[beside], gone_j[beside]
        if not len(row):
            return np.zeros(len(rows))
        one, other, pose = rows[row], good[column], self._estimate.pose
        to_a = between(pose[t.first[one]], pose[t.first[other]])
        to_b = between(pose[t.second[one]], pose[t.second[other]])
        expected = compose(inverse(to_a), compose(t.transform[one], to_b))
        off = t.transform[other] - expected
        far = np.abs(gone_i) + np.abs(gone_j)
        fits = np.hypot(off[:, 0], off[:, 1]) < LIKELIHOOD.gate_m + DRIFT_PER_M * far
        fits &= np.abs(wrap(off[:, 2])) < LEAST_TURN_RAD
        row, other = row[fits], other[fits]
        cell = np.rint(gone_i[fits] / VIEW_LOOPS.cell_m).astype(np.int64)
        keys, which = np.unique(row * 64 + cell + 32, return_inverse=True)
        mean = np.bincount(which, own[other]) / np.bincount(which)
        return np.asarray(np.bincount(keys // 64, mean, len(rows)), np.float64)

    def _leads(self, likely: IntArray, total: FloatArray) -> BoolArray:
        """Whether each of these pairs leads all others of its places that say something else."""
        t, way = self._tested, self._way
        pose, rivals = self._estimate.pose, np.flatnonzero(total > 0)
        out = np.ones(len(likely), bool)
        sides = (t.first, t.second, t.transform), (t.second, t.first, inverse(t.transform))
        for here, there, transform in sides:
            # Where each pair puts the place `there`, moved along the way to the same place.
            row, column = _within(way[here[likely]], way[here[rivals]], 0.5 * VIEW_LOOPS.cell_m)
            one, other = likely[row], rivals[column]
            to = between(pose[here[one]], pose[here[other]])
            placed = compose(pose[here[one]], compose(to, transform[other]))
            claimed = compose(pose[here[one]], transform[one])
            step = between(pose[there[other]], pose[there[one]])
            off = compose(placed, step)[:, :2] - claimed[:, :2]
            against = np.hypot(off[:, 0], off[:, 1]) > VIEW_LOOPS.reach_m
            against &= total[other] > total[one] - EVIDENCE.lead
            out[row[against]] = False
        return out

    def _optimise(self) -> None:
        start = self._estimate.pose
        self._estimate = optimise(self._with_loops(), self._place, start)

    def _with_loops(self) -> DeadReckoning:
        t, kept = self._tested, self._kept
        loops = Factors(
            t.first[kept],
            t.second[kept],
            t.transform[kept],
            self._information(t.information[kept], t.transform[kept, 2]),
        )
        return replace(self._given, loops=loops)

    def _information(self, walls: FloatArray, turn: FloatArray) -> FloatArray:
        """(k, 3, 3) of the loops, in the axes of their second views."""
        # Along bare corridors a registration stays within reach, and tells no more.
        open_ = np.diag([1 / VIEW_LOOPS.reach_m**2] * 2 + [1 / LEAST_TURN_RAD**2])
        cov = np.linalg.inv(walls + open_)
        cov = cov + np.diag([VIEW_LOOPS.sigma_m**2] * 2 + [VIEW_LOOPS.sigma_rad**2])
        R = turned_axes(-turn)
        out = np.linalg.inv(R @ cov @ R.transpose(0, 2, 1))
        return 0.5 * (out + out.transpose(0, 2, 1))


def _within(
    a: FloatArray | IntArray, b: FloatArray | IntArray, reach: float
) -> tuple[IntArray, IntArray]:
    """Rows of a and of b whose values differ by `reach` at most."""
    order = np.argsort(b, kind="stable")
    low = np.searchsorted(b[order], a - reach, side="left")
    row, nth = numbered(np.searchsorted(b[order], a + reach, side="right") - low)
    return row, order[low[row] + nth]
