"""Loops closed by views: where a run saw again what it had seen before.

Like full closure (`incremental.py`), in rounds, the most certain first: pairs of views that position
allows are registered, what agrees beyond what other places of the run do becomes a loop, the track is
laid out again, and with its smaller uncertainty more pairs can be told. A loop must lead every other
one that its places offer.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..matching.likelihood import BIT, LIKELIHOOD
from ..matching.views import TURN_RAD, Registered, ViewIndex, ViewNull, register
from ..se2 import between, compose, turned, wrap
from .dead_reckoning import DeadReckoning, Loops, dead_reckoning_covariance, scale_noise
from .estimate import Estimate, EstimateSettings, optimise


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
    tests: int = 12
    """Pairs per view that are registered at most, which bounds the time."""
    nulls: int = 300
    """Pairs of places that position keeps apart, registered to learn what they look like."""
    rounds: int = 12
    wrong_share: float = 0.1
    """Share of runs with a wrong loop if all of them just reach the required odds; as of
    `RoundSettings`."""
    place_m2: float = 50.0
    """Area that one place stands for: another one may be anywhere else."""
    cell_m: float = 8.0
    """Views of places nearer than this to each other are not independent: they count once."""
    beside_m: float = 30.0
    """Way along which loops support each other."""
    lead: float = 3.0
    """Log odds [nats] by which a loop leads its rivals; as of `EvidenceSettings`."""
    sigma_m: float = 0.07
    sigma_rad: float = 0.01
    """1 sigma of a registration, beyond what its walls leave open: median errors against the true
    tracks of four buildings are .09 to .19 m, those of the truth included, and .02 rad."""


@dataclass(eq=False)
class _Tested:
    """Pairs of views that were registered: rows first < second, transform of the second in the
    first, z, information."""

    first: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    second: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    transform: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    z: FloatArray = field(default_factory=lambda: np.zeros(0))
    information: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))

    def __len__(self) -> int:
        return len(self.first)

    def add(self, first: IntArray, second: IntArray, found: Registered) -> None:
        self.first = np.concatenate([self.first, first])
        self.second = np.concatenate([self.second, second])
        self.transform = np.concatenate([self.transform, found.transform])
        self.z = np.concatenate([self.z, found.z])
        self.information = np.concatenate([self.information, found.information])


def view_loops(
    reckoning: DeadReckoning,
    views: ViewIndex,
    way: FloatArray,
    settings: ViewLoopSettings = ViewLoopSettings(),
) -> tuple[DeadReckoning, Estimate]:
    """The reckoning with its loops, and the estimate of its poses with these.

    reckoning: of the views' places, whose passes have no branches; way: (n,) distance driven [m].
    """
    return _Search(reckoning, views, way, settings).run()


class _Search:
    """The state of a search for loops."""

    def __init__(
        self,
        reckoning: DeadReckoning,
        views: ViewIndex,
        way: FloatArray,
        settings: ViewLoopSettings,
    ) -> None:
        self._views, self._way, self._settings = views, way, settings
        self._given = reckoning
        self._scale = 1.0
        self._place = np.arange(len(reckoning), dtype=np.int64)
        self._own = EstimateSettings()
        i, j = np.triu_indices(len(reckoning), 1)
        fine = (way[j] - way[i] >= settings.apart_m) & (reckoning.piece[i] == reckoning.piece[j])
        self._i, self._j = i[fine], j[fine]
        self._open = np.ones(len(self._i), bool)
        self._tested = _Tested()
        self._kept = np.zeros(0, np.int64)
        self._blocked: set[int] = set()
        self._estimate = optimise(reckoning, self._place, settings=self._own)
        self._different = np.zeros(0)

    def run(self) -> tuple[DeadReckoning, Estimate]:
        if not len(self._i):
            return self._given, self._estimate
        left = self._settings.tests * len(self._given)
        for number in range(self._settings.rounds):
            shift, cov = self._apart(first=number == 0)
            if number == 0:
                self._learn(shift, cov)
            most = min(left, max(left // 4, len(self._given)))
            tested = self._test(shift, cov, most)
            left -= tested
            if not self._close(shift, cov) and not tested:
                break
        return self._with_loops(), self._estimate

    def _apart(self, *, first: bool) -> tuple[FloatArray, FloatArray]:
        """(k, 3) pose of the second view of every pair in the first one's frame, and its
        covariance (k, 3, 3)."""
        i, j = self._i, self._j
        pose = self._estimate.pose
        shift = between(pose[i], pose[j])
        if first:
            cov = dead_reckoning_covariance(self._given, i, j) * self._settings.doubt**2
        else:
            cov = self._estimate.relative_covariance(i, j)
        return shift, cov

    def _learn(self, shift: FloatArray, cov: FloatArray) -> None:
        """Register pairs of places that position keeps apart."""
        sigma = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1])
        away = np.hypot(shift[:, 0], shift[:, 1])
        rows = np.flatnonzero(away > 3 * sigma + 2 * self._settings.reach_m)
        rows = rows[:: max(len(rows) // self._settings.nulls, 1)]
        nothing = np.zeros((len(rows), 3))
        nothing[:, 2] = shift[rows, 2]
        found = self._registered(self._i[rows], self._j[rows], nothing, cov[rows, 2, 2])
        self._different = found.z

    def _registered(
        self, i: IntArray, j: IntArray, expected: FloatArray, turn_variance: FloatArray
    ) -> Registered:
        half = np.ceil((0.1 + 3 * np.sqrt(turn_variance)) / TURN_RAD)
        half = np.clip(half, 2, 18).astype(np.int64)
        parts: list[tuple[IntArray, Registered]] = []
        # Pairs with turns about as well known are registered at once.
        for wide in (2, 4, 8, 18):
            rows = np.flatnonzero((half <= wide) & (half > {2: 0, 4: 2, 8: 4, 18: 8}[wide]))
            if len(rows):
                turns = expected[rows, 2:] + np.arange(-wide, wide + 1) * TURN_RAD
                found = register(
                    *(self._views, self._views, i[rows], j[rows], turns),
                    reach_m=self._settings.reach_m,
                    centre=expected[rows, :2],
                )
                parts.append((rows, found))
        order = np.argsort(np.concatenate([rows for rows, _ in parts] or [np.zeros(0, np.int64)]))

        def merged(name: str, shape: tuple[int, ...]) -> FloatArray:
            values = [getattr(found, name) for _, found in parts]
            return np.concatenate(values)[order] if values else np.zeros(shape)

        return Registered(
            merged("transform", (0, 3)),
            merged("agree", (0,)),
            merged("contradict", (0,)),
            merged("information", (0, 3, 3)),
        )

    def _test(self, shift: FloatArray, cov: FloatArray, most: int) -> int:
        """Register the pairs most likely to be of one place; their number."""
        reach = self._settings.reach_m
        variance = 0.5 * (cov[:, 0, 0] + cov[:, 1, 1]) + (0.5 * reach) ** 2
        near2 = shift[:, 0] ** 2 + shift[:, 1] ** 2
        odds = -0.5 * near2 / variance - np.log(variance)
        rows = np.flatnonzero(self._open & (near2 < 9 * variance + reach**2) & (near2 < 15.0**2))
        rows = rows[np.argsort(-odds[rows], kind="stable")[:most]]
        if not len(rows):
            return 0
        self._open[rows] = False
        i, j = self._i[rows], self._j[rows]
        centre = shift[rows].copy()
        # Registration looks within `reach_m` of the place that is expected, in steps if it is vague.
        found = self._registered(i, j, centre, cov[rows, 2, 2])
        self._tested.add(i, j, found)
        return len(rows)

    def _null(self) -> ViewNull:
        same = self._tested.z[self._kept]
        return ViewNull.of(self._different, same)

    def _close(self, shift: FloatArray, cov: FloatArray) -> bool:
        """Accept the loops that are certain by now, and lay the track out again."""
        t, settings = self._tested, self._settings
        if not len(t):
            return False
        own = self._null().odds(t.z)
        n = len(self._given)
        key = self._i * n + self._j
        at = np.searchsorted(key, t.first * n + t.second)
        position = self._position(t, shift[at], cov[at])
        total = self._supported(t, own) + position
        need = float(np.log(n / settings.wrong_share))
        fine = (total >= need) & (own > 0)
        fine[list(self._blocked)] = False
        rows = np.flatnonzero(fine)
        rows = rows[self._leads(rows, total)]
        new = np.setdiff1d(rows, self._kept)
        if not len(new):
            return False
        self._kept = np.union1d(self._kept, rows)
        self._optimise()
        bad = self._estimate.loop_chi2 > LIKELIHOOD.gate_chi2(3)
        if bad.any():
            self._blocked |= set(self._kept[bad].tolist())
            self._kept = self._kept[~bad]
            self._optimise()
        return True

    def _position(self, t: _Tested, shift: FloatArray, cov: FloatArray) -> FloatArray:
        """(k,) log odds [nats] of the transforms by position: density where they are expected,
        against anywhere."""
        off = t.transform - shift
        off[:, 2] = wrap(off[:, 2])
        s = cov + np.diag([self._settings.sigma_m**2] * 2 + [self._settings.sigma_rad**2 * 4])
        s = s[:, :2, :2]
        d2 = np.einsum("ki,kij,kj->k", off[:, :2], np.linalg.inv(s), off[:, :2])
        det = np.linalg.det(s)
        odds = np.log(self._settings.place_m2) - np.log(2 * np.pi * np.sqrt(det)) - 0.5 * d2
        return np.minimum(odds, self._settings.lead)

    def _supported(self, t: _Tested, own: FloatArray) -> FloatArray:
        """(k,) evidence of each pair together with that of the pairs beside it that agree with it,
        one per cell of the way."""
        settings, way, pose = self._settings, self._way, self._given_pose
        total = own.copy()
        good = np.flatnonzero(own > 0)
        wi, wj = way[t.first[good]], way[t.second[good]]
        for k, row in enumerate(good.tolist()):
            beside = np.flatnonzero(
                (np.abs(wi - wi[k]) < settings.beside_m) & (np.abs(wj - wj[k]) < settings.beside_m)
            )
            if len(beside) < 2:
                continue
            others = good[beside]
            a, b = t.first[row], t.second[row]
            to_a = between(np.repeat(pose[a][None], len(others), 0), pose[t.first[others]])
            to_b = between(np.repeat(pose[b][None], len(others), 0), pose[t.second[others]])
            expected = between(to_a, compose(t.transform[row], to_b))
            off = t.transform[others] - expected
            gone = np.abs(wi[beside] - wi[k]) + np.abs(wj[beside] - wj[k])
            fits = np.hypot(off[:, 0], off[:, 1]) < LIKELIHOOD.gate_m + 0.02 * gone
            fits &= np.abs(wrap(off[:, 2])) < 0.1
            cell = np.rint((wi[beside] - wi[k]) / settings.cell_m).astype(np.int64)
            across = np.rint((wj[beside] - wj[k]) / settings.cell_m).astype(np.int64)
            fits &= (cell != 0) & (across != 0)
            if fits.any():
                _, which = np.unique(cell[fits], return_inverse=True)
                sums = np.bincount(which, own[others[fits]]) / np.bincount(which)
                total[row] += float(sums.sum())
        return total

    @property
    def _given_pose(self) -> FloatArray:
        return self._estimate.pose

    def _leads(self, rows: IntArray, total: FloatArray) -> BoolArray:
        """Whether each of these pairs leads all others of its places that say something else."""
        t, way, settings = self._tested, self._way, self._settings
        out = np.ones(len(rows), bool)
        rivals = np.flatnonzero(total > 0)
        pose = self._estimate.pose
        placed = compose(pose[t.first], t.transform)
        back = compose(pose[t.second], _inverse(t.transform))
        for k, row in enumerate(rows.tolist()):
            near_b = np.abs(way[t.second[rivals]] - way[t.second[row]]) < settings.cell_m / 2
            near_a = np.abs(way[t.first[rivals]] - way[t.first[row]]) < settings.cell_m / 2
            # Where each of them puts the second view, moved to the same view.
            step_b = turned(
                pose[t.second[row], :2] - pose[t.second[rivals], :2],
                placed[rivals, 2] - pose[t.second[rivals], 2],
            )
            step_a = turned(
                pose[t.first[row], :2] - pose[t.first[rivals], :2],
                back[rivals, 2] - pose[t.first[rivals], 2],
            )
            far_b = np.hypot(*(placed[rivals, :2] + step_b - placed[row, :2]).T) > settings.reach_m
            far_a = np.hypot(*(back[rivals, :2] + step_a - back[row, :2]).T) > settings.reach_m
            against = rivals[(near_b & far_b) | (near_a & far_a)]
            out[k] = not np.any(total[against] > total[row] - settings.lead)
        return out

    def _optimise(self) -> None:
        reckoning = self._with_loops()
        estimate = optimise(reckoning, self._place, self._estimate.pose, settings=self._own)
        if estimate.reduced_chi2 * estimate.freedom > LIKELIHOOD.gate_chi2(estimate.freedom):
            self._scale *= float(np.sqrt(estimate.reduced_chi2))
            reckoning = self._with_loops()
            estimate = optimise(reckoning, self._place, estimate.pose, settings=self._own)
        self._estimate = estimate

    def _with_loops(self) -> DeadReckoning:
        t, kept = self._tested, self._kept
        loops = Loops(
            t.first[kept],
            t.second[kept],
            t.transform[kept],
            self._information(t.information[kept], t.transform[kept, 2]),
        )
        reckoning = scale_noise(self._given, self._scale) if self._scale > 1 else self._given
        return replace(reckoning, loops=loops)

    def _information(self, walls: FloatArray, turn: FloatArray) -> FloatArray:
        """(k, 3, 3) of the loops, in the axes of their second views."""
        settings = self._settings
        # Along bare corridors a registration stays within reach, and tells no more.
        open_ = np.diag([1 / settings.reach_m**2] * 2 + [1 / 0.1**2])
        cov = np.linalg.inv(walls + open_)
        cov = cov + np.diag([settings.sigma_m**2] * 2 + [settings.sigma_rad**2])
        c, s = np.cos(turn), np.sin(turn)
        R = np.zeros((len(turn), 3, 3))
        R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, s, -s, c, 1.0
        out = np.linalg.inv(R @ cov @ R.transpose(0, 2, 1))
        return 0.5 * (out + out.transpose(0, 2, 1))


def _inverse(T: FloatArray) -> FloatArray:
    from ..se2 import inverse

    return inverse(T)


_ = BIT
