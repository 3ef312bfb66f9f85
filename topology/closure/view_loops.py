"""Loops closed by views: revisits found by what a laser saw.

In rounds like full closure (`incremental.py`), the most certain first. Pairs of views that position
allows are registered. A pair that agrees better than different places of the run becomes a loop,
and the track is optimised again; its smaller uncertainty admits more pairs. A loop must lead every
contradicting pair of its places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import joined, take
from ..matching.likelihood import LIKELIHOOD
from ..matching.views import TURN_RAD, Registered, ViewIndex, ViewNull, coarse_fit, register
from ..posegraph.graph import Measurements
from ..ragged import rows_within
from ..se2 import between, compose, inverse, turned_axes, wrap
from .candidates import pairs_within
from .dead_reckoning import DeadReckoning, relative_covariance
from .estimate import Estimate, optimise
from .evidence import EVIDENCE
from .incremental import needed_odds


@dataclass(frozen=True, slots=True)
class ViewLoopSettings:
    """Which views are compared, and when they are one place."""

    reach_m: float = 2.0
    """Largest distance of two views that overlap enough to be compared."""
    doubt: float = 2.0
    """Factor on the noise of dead reckoning before the first loop: in one of five buildings the
    noise was underestimated by as much."""
    tests: int = 12
    """Upper bound of the registered pairs per view, which bounds the time."""
    nulls: int = 300
    """Null pairs that are registered: pairs of places that position keeps apart."""
    copies: int = 4
    """Pairs per view that are registered to find copies of its place: with those of the
    `references` that fit it best."""
    references: int = 60
    """Upper bound of the views, one per `cell_m` of way and spread over the run, in which copies
    are searched; it bounds the time."""
    pairs: int = 30_000
    """Pairs of views, the nearest to each other, among which those to register are chosen: 50
    MB."""
    cell_m: float = 8.0
    """Distance within which views are not independent, so that they count once. Its square is the
    area of one place, the null model of position: another place may be anywhere else."""
    sigma_m: float = 0.07
    sigma_rad: float = 0.01
    """1 sigma of a registration in addition to the covariance by its walls. Median errors against
    the true tracks of four buildings are .09 to .19 m, those of the truth included, and .02 rad."""

    @property
    def apart_m(self) -> float:
        """Least distance along the way of two views that share no scans: a view is made of 10 m
        before and after its place."""
        return 3 * self.cell_m

    @property
    def beside_m(self) -> float:
        """Way along which loops support each other."""
        return 4 * self.cell_m

    @property
    def known_m(self) -> float:
        """Pairs whose relative position is known to this (1 sigma) are not registered."""
        return 2 * self.sigma_m

    @property
    def gate_chi2(self) -> float:
        """Largest squared distance, in standard deviations (95 %), at which a pair is registered:
        where copies abound, a place that is hardly possible is a copy."""
        return float(chdtri(2, LIKELIHOOD.outlier_share))


VIEW_LOOPS = ViewLoopSettings()


LEAST_TURN_RAD = 0.1
"""Turns are searched by this much beyond three sigmas, as the noise may be underestimated. Also 1
sigma of a turn by a bare corridor, and the largest difference of turns that agree."""
DRIFT_PER_M = 0.02
"""Difference of two registrations that agree, per metre of way between them, beside `gate_m`. It is
a little less than the usual drift of odometry within `beside_m` (.03, by heading errors of .009 rad
per √m)."""
TURNS = np.array([2, 4, 8, 18, 36])
"""Numbers of steps of `TURN_RAD` to either side that are searched."""


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

    def with_pairs(self, first: IntArray, second: IntArray, registered: Registered) -> _Tested:
        """These pairs and newly registered ones."""
        new = _Tested(first, second, registered.transform, registered.z, registered.information)
        return joined([self, new])


_NO_ROWS = np.zeros(0, np.int64)
_NONE_TESTED = _Tested(_NO_ROWS, _NO_ROWS, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3, 3)))


def view_loops(
    reckoning: DeadReckoning, views: ViewIndex, arc_m: FloatArray
) -> tuple[DeadReckoning, Estimate]:
    """The reckoning with its loops, and the estimate of its poses with these.

    reckoning: of the views' places, without branches; arc_m: (n,) distance driven [m].
    """
    return _Search(reckoning, views, arc_m).run()


class _Search:
    """The state of a search for loops."""

    def __init__(self, reckoning: DeadReckoning, views: ViewIndex, arc_m: FloatArray) -> None:
        self._views, self._arc_m = views, arc_m
        self._reckoning = reckoning
        self._place = np.arange(len(reckoning), dtype=np.int64)
        self._tested = self._copies = _NONE_TESTED
        self._accepted = self._compared = _NO_ROWS
        self._blocked: set[int] = set()
        self._estimate = optimise(reckoning, self._place)
        self._null_z = np.zeros(0)

    def run(self) -> tuple[DeadReckoning, Estimate]:
        """Register the pairs most likely to be of one place and accept the certain loops, in rounds
        until nothing is found, or as many pairs as `tests` allows were registered."""
        remaining = VIEW_LOOPS.tests * len(self._reckoning)
        if remaining:
            self._register_null_pairs()
        while remaining > 0:
            count = self._register_likely(max(remaining // 4, len(self._reckoning)))
            remaining -= count
            if not self._accept_certain() and not count:
                break
        return self._with_loops(), self._estimate

    def _untested(self) -> tuple[IntArray, IntArray]:
        """The nearest pairs of views that share no scans and were not registered yet."""
        xy, way, piece = self._estimate.pose[:, :2], self._arc_m, self._reckoning.piece
        i, j = pairs_within(xy, float(np.ptp(xy, axis=0).sum()), VIEW_LOOPS.pairs).T
        allowed = (way[j] - way[i] >= VIEW_LOOPS.apart_m) & (piece[i] == piece[j])
        tested_keys = self._tested.first * len(xy) + self._tested.second
        allowed &= ~np.isin(i * len(xy) + j, tested_keys)
        return i[allowed], j[allowed]

    def _relative(self, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3) estimated poses of views j in the frames of views i, and their covariance
        (k, 3, 3): before the first loop, that of dead reckoning times `doubt`²."""
        shift = between(self._estimate.pose[i], self._estimate.pose[j])
        if not len(self._accepted):
            doubt = VIEW_LOOPS.doubt**2
            return shift, relative_covariance(self._reckoning, i, j) * doubt
        return shift, self._estimate.relative_covariance(i, j)

    def _register_null_pairs(self) -> None:
        """Register a sample of pairs that position keeps apart: their z is the null model."""
        count = len(self._reckoning)
        sample = np.random.default_rng(0).integers(0, count, (20 * VIEW_LOOPS.nulls, 2))
        i, j = np.unique(np.sort(sample, axis=1), axis=0).T
        allowed = self._arc_m[j] - self._arc_m[i] >= VIEW_LOOPS.apart_m
        allowed &= self._reckoning.piece[i] == self._reckoning.piece[j]
        i, j = i[allowed], j[allowed]
        shift, cov = self._relative(i, j)
        rows = np.flatnonzero(self._are_apart(shift, cov))
        rows = rows[:: max(len(rows) // VIEW_LOOPS.nulls, 1)]
        coincident = np.zeros((len(rows), 3))
        coincident[:, 2] = shift[rows, 2]
        self._null_z = self._register(i[rows], j[rows], coincident, cov[rows, 2, 2]).z

    def _register_copies(self, rows: IntArray) -> None:
        """Register views `rows` with the reference views that they fit best (`copies`)."""
        rows = np.setdiff1d(rows, self._compared)
        self._compared = np.union1d(self._compared, rows)
        cell = np.floor(self._arc_m / VIEW_LOOPS.cell_m)
        references = np.flatnonzero(np.diff(cell, prepend=-1) > 0)
        references = references[:: -(-len(references) // VIEW_LOOPS.references)]
        i, j = (x.ravel() for x in np.meshgrid(rows, references, indexing="ij"))
        allowed = np.abs(self._arc_m[i] - self._arc_m[j]) > VIEW_LOOPS.cell_m
        allowed &= self._reckoning.piece[i] == self._reckoning.piece[j]
        i, j = i[allowed], j[allowed]
        turn = wrap(self._estimate.pose[j, 2] - self._estimate.pose[i, 2])
        turns = turn[:, None] + np.arange(-1, 2) * TURN_RAD
        reach_m = 0.5 * VIEW_LOOPS.cell_m
        fit = coarse_fit(self._views, i, j, turns, reach_m)
        order = np.lexsort((-fit, i))
        rank = np.arange(len(i)) - np.searchsorted(i[order], i[order])
        best = order[rank < VIEW_LOOPS.copies]
        i, j = i[best], j[best]
        registered = register(self._views, self._views, i, j, turns[best], reach_m=reach_m)
        self._copies = self._copies.with_pairs(i, j, registered)

    def _copy_z(self, null: ViewNull) -> FloatArray:
        """(k,) largest z of the views of each tested pair with copies of their places; -inf without
        copies. A copy lies certainly elsewhere, and agrees along the way, too."""
        tested, found = self._tested, self._copies
        odds = null.odds(found.z)
        likely = np.flatnonzero(odds > 0)
        copies = likely[self._support(found, likely, odds) > 0]
        level = np.full(len(tested), -np.inf)
        for side, other_side in ((tested.first, tested.second), (tested.second, tested.first)):
            # Copies of this side are rivals if they are apart from the other side.
            row, column = rows_within(side, found.first[copies], 0.0)
            opposite, copy_place = other_side[row], found.second[copies[column]]
            distant = np.flatnonzero(opposite != copy_place)
            pairs = np.sort([opposite[distant], copy_place[distant]], axis=0)
            distant = distant[self._are_apart(*self._relative(*pairs))]
            np.maximum.at(level, row[distant], found.z[copies[column[distant]]])
        return level

    def _are_apart(self, shift: FloatArray, cov: FloatArray) -> BoolArray:
        """(k,) whether pairs are certainly apart by position."""
        sigma = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1])
        least_m = np.sqrt(VIEW_LOOPS.gate_chi2) * sigma + 2 * VIEW_LOOPS.reach_m
        return np.asarray(np.hypot(shift[:, 0], shift[:, 1]) > least_m)

    def _register_likely(self, most: int) -> int:
        """Register the pairs most likely to be of one place by position. Returns their number."""
        i, j = self._untested()
        shift, cov = self._relative(i, j)
        reach2 = VIEW_LOOPS.reach_m**2
        position_variance = 0.5 * (cov[:, 0, 0] + cov[:, 1, 1])
        variance = position_variance + (0.5 * VIEW_LOOPS.reach_m) ** 2
        distance2 = shift[:, 0] ** 2 + shift[:, 1] ** 2
        odds = -0.5 * distance2 / variance - np.log(variance)
        in_reach = distance2 < VIEW_LOOPS.gate_chi2 * variance
        rows = np.flatnonzero(in_reach & (position_variance > 0.5 * VIEW_LOOPS.known_m**2))
        rows = rows[np.argsort(-odds[rows], kind="stable")[:most]]
        if len(rows):
            i, j, expected = i[rows], j[rows], shift[rows].copy()
            # If they are of one place, they are near to each other, wherever they are expected.
            expected[:, :2] *= (reach2 / (reach2 + position_variance[rows]))[:, None]
            registered = self._register(i, j, expected, cov[rows, 2, 2])
            self._tested = self._tested.with_pairs(i, j, registered)
        return len(rows)

    def _register(
        self, i: IntArray, j: IntArray, expected: FloatArray, turn_variance: FloatArray
    ) -> Registered:
        """Register views j (k,) with views i around the expected poses (k, 3), whose turns have
        variances (k,) [rad²]."""
        needed_width = np.ceil((LEAST_TURN_RAD + 3 * np.sqrt(turn_variance)) / TURN_RAD)
        # Pairs with as many turns to search are registered at once.
        width = TURNS[np.minimum(np.searchsorted(TURNS, needed_width), len(TURNS) - 1)]
        order, registrations = [], []
        for half_width in TURNS.tolist():
            rows = np.flatnonzero(width == half_width)
            turns = expected[rows, 2:] + np.arange(-half_width, half_width + 1) * TURN_RAD
            order.append(rows)
            registrations.append(
                register(
                    *(self._views, self._views, i[rows], j[rows], turns),
                    reach_m=VIEW_LOOPS.reach_m,
                    centre=expected[rows, :2],
                )
            )
        return take(joined(registrations), np.argsort(np.concatenate(order)))

    def _accept_certain(self) -> bool:
        """Accept the certain loops, optimise the track again, and take back outliers. Returns
        whether there were any."""
        certain = self._certain()
        if not len(certain):
            return False
        self._accepted = np.union1d(self._accepted, certain)
        self._optimise()
        outlier = self._estimate.loop_chi2 > LIKELIHOOD.gate_chi2(3)
        if outlier.any():
            self._blocked |= set(self._accepted[outlier].tolist())
            self._accepted = self._accepted[~outlier]
            self._optimise()
        return True

    def _certain(self) -> IntArray:
        """Rows of the tested pairs that are certainly of one place and lead all their rivals. The
        evidence is that of walls, pairs along the way, and position."""
        tested = self._tested
        null = ViewNull.of(self._null_z, tested.z[self._accepted])
        odds = null.odds(tested.z)
        self._register_copies(np.unique([tested.first[odds > 0], tested.second[odds > 0]]))
        odds = null.odds(tested.z, self._copy_z(null))
        open_pairs = np.setdiff1d(np.flatnonzero(odds > 0), [*self._accepted, *self._blocked])
        if not len(open_pairs):
            return open_pairs
        total = odds.copy()
        total[open_pairs] += self._support(tested, open_pairs, odds)
        expected = self._relative(tested.first[open_pairs], tested.second[open_pairs])
        total[open_pairs] += self._position_odds(tested.transform[open_pairs], *expected)
        sufficient = open_pairs[total[open_pairs] >= needed_odds(len(self._reckoning))]
        return np.asarray(sufficient[self._leads(sufficient, total)])

    def _position_odds(
        self, transform: FloatArray, shift: FloatArray, cov: FloatArray
    ) -> FloatArray:
        """(k,) log odds [nats] of registered transforms by position: normal about the expected
        shift, against uniform over a cell."""
        offset = (transform - shift)[:, :2]
        spread = cov[:, :2, :2] + VIEW_LOOPS.sigma_m**2 * np.eye(2)
        d2 = np.einsum("ki,kij,kj->k", offset, np.linalg.inv(spread), offset)
        area = 2 * np.pi * np.sqrt(np.linalg.det(spread))
        odds = np.log(VIEW_LOOPS.cell_m**2 / area) - 0.5 * d2
        return np.asarray(np.minimum(odds, EVIDENCE.lead))

    def _support(self, tested: _Tested, rows: IntArray, odds: FloatArray) -> FloatArray:
        """(k,) evidence [nats] for the tested pairs `rows` by pairs along the way that agree with
        them: the sum of the means of all cells. odds: of each pair by its walls."""
        arc_m = self._arc_m
        likely = np.flatnonzero(odds > 0)
        arc_i, arc_j = arc_m[tested.first], arc_m[tested.second]
        row, column = rows_within(arc_i[rows], arc_i[likely], VIEW_LOOPS.beside_m)
        along_i = arc_i[likely[column]] - arc_i[rows[row]]
        along_j = arc_j[likely[column]] - arc_j[rows[row]]
        # Both sides have to be other places.
        least_m = np.minimum(np.abs(along_i), np.abs(along_j))
        separate = (least_m > 0.5 * VIEW_LOOPS.cell_m) & (np.abs(along_j) < VIEW_LOOPS.beside_m)
        row, column = row[separate], column[separate]
        along_i, along_j = along_i[separate], along_j[separate]
        if not len(row):
            return np.zeros(len(rows))
        pair, neighbour, pose = rows[row], likely[column], self._estimate.pose
        step_a = between(pose[tested.first[pair]], pose[tested.first[neighbour]])
        step_b = between(pose[tested.second[pair]], pose[tested.second[neighbour]])
        expected = compose(inverse(step_a), compose(tested.transform[pair], step_b))
        residual = tested.transform[neighbour] - expected
        tolerance_m = LIKELIHOOD.gate_m + DRIFT_PER_M * (np.abs(along_i) + np.abs(along_j))
        fits = np.hypot(residual[:, 0], residual[:, 1]) < tolerance_m
        fits &= np.abs(wrap(residual[:, 2])) < LEAST_TURN_RAD
        row, neighbour = row[fits], neighbour[fits]
        cell = np.rint(along_i[fits] / VIEW_LOOPS.cell_m).astype(np.int64)
        keys, group = np.unique(row * 64 + cell + 32, return_inverse=True)
        mean = np.bincount(group, odds[neighbour]) / np.bincount(group)
        return np.asarray(np.bincount(keys // 64, mean, len(rows)), np.float64)

    def _leads(self, likely: IntArray, total: FloatArray) -> BoolArray:
        """(k,) whether each pair leads all that contradict it. total: odds of all tested pairs."""
        tested, arc_m = self._tested, self._arc_m
        pose, rivals = self._estimate.pose, np.flatnonzero(total > 0)
        leads = np.ones(len(likely), bool)
        sides = (
            (tested.first, tested.second, tested.transform),
            (tested.second, tested.first, inverse(tested.transform)),
        )
        for side, other_side, transform in sides:
            # The positions that pair and rival give to the pair's other place.
            row, column = rows_within(
                arc_m[side[likely]], arc_m[side[rivals]], 0.5 * VIEW_LOOPS.cell_m
            )
            pair, rival = likely[row], rivals[column]
            step_side = between(pose[side[pair]], pose[side[rival]])
            rival_place = compose(pose[side[pair]], compose(step_side, transform[rival]))
            pair_place = compose(pose[side[pair]], transform[pair])
            step_other = between(pose[other_side[rival]], pose[other_side[pair]])
            residual = compose(rival_place, step_other)[:, :2] - pair_place[:, :2]
            contradicts = np.hypot(residual[:, 0], residual[:, 1]) > VIEW_LOOPS.reach_m
            contradicts &= total[rival] > total[pair] - EVIDENCE.lead
            leads[row[contradicts]] = False
        return leads

    def _optimise(self) -> None:
        start = self._estimate.pose
        self._estimate = optimise(self._with_loops(), self._place, start)

    def _with_loops(self) -> DeadReckoning:
        tested, accepted = self._tested, self._accepted
        loops = Measurements(
            tested.first[accepted],
            tested.second[accepted],
            tested.transform[accepted],
            self._information(tested.information[accepted], tested.transform[accepted, 2]),
        )
        return replace(self._reckoning, loops=loops)

    def _information(self, walls: FloatArray, turn: FloatArray) -> FloatArray:
        """(k, 3, 3) information of the loops, in the axes of their second views."""
        # Along bare corridors a registration is only known to be within reach.
        least_information = np.diag([1 / VIEW_LOOPS.reach_m**2] * 2 + [1 / LEAST_TURN_RAD**2])
        cov = np.linalg.inv(walls + least_information)
        cov = cov + np.diag([VIEW_LOOPS.sigma_m**2] * 2 + [VIEW_LOOPS.sigma_rad**2])
        R = turned_axes(-turn)
        information = np.linalg.inv(R @ cov @ R.transpose(0, 2, 1))
        return 0.5 * (information + information.transpose(0, 2, 1))
