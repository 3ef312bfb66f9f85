"""Full closure: incremental identification, the most certain first.

A run is available as a whole, so it is not closed pass by pass. Each round makes the certain
identifications and optimises the pose graph again, which leaves less uncertainty to the next.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import take
from ..connected import connected
from ..matching.likelihood import BIT, LIKELIHOOD
from .answers import AGREE, COMMON, DISAGREE, TOGETHER, TORN, UNSURE, Identification
from .branches import branches_of
from .candidates import Candidates, candidates
from .dead_reckoning import DeadReckoning, scale_noise
from .estimate import Estimate, optimise
from .evidence import background, measured_rates
from .growth import MapState
from .joint_compatibility import NO_AGREEMENT, Agreement, jointly_certain
from .lattice import lattice_of
from .manhattan import GridCorridors, GridHeadings, grid_corridors, grid_headings
from .places import Places, tabulate


@dataclass(frozen=True, slots=True)
class RoundSettings:
    """When an identification is certain enough.

    Ablation of each mechanism: `benchmarks/ablation.txt`, part 1.
    """

    wrong_share: float = 0.1
    """Share of runs with a wrong identification, if all identifications just reach the required
    odds. Tried
    on walks through equal aisles: with 0.1 one of 16 is closed wrongly, with 0.05 two, with 0.2 two
    of the first five; but 0.2 joins two passes in a part of Intel that 0.1 does not."""
    strict_wrong_share: float = 0.002
    """The same for the stricter one of the alternative closures (`alternatives.py`). Of 120 city
    walks at high drift 5 hold two places as one; with alternatives by 0.1 3, by 0.02 as well 1, by
    0.002 none."""
    most_crossing: float = 0.05
    """Least share of crossing corridors at which a run is closed again (`alternatives.py`): of 574
    simulated runs that are closed rightly 9 % have as many, of 13 in streets that are not, 12."""
    caution: float = 1.25
    """Factor on the estimated random errors: a dozen revisits estimate a sigma to a quarter."""


ROUNDS = RoundSettings()


def needed_odds(passes: int, wrong_share: float = ROUNDS.wrong_share) -> float:
    """Log odds [nats] required of an identification in a run of `passes` passes.

    Each pass is one chance of a wrong identification (Bonferroni bound).
    """
    return float(np.log(passes / wrong_share))


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """A run with its loops closed.

    reckoning: the one given, with its noise raised by `caution` and by the residuals of the
    estimate; place: (p,) place of each pass, numbered by first visit; estimate: the optimised
    positions; identifications: all accepted ones, those taken back, and the refused candidates of
    the last round; grid: headings by the building's grid, if it has one.
    """

    reckoning: DeadReckoning
    place: IntArray
    estimate: Estimate
    identifications: list[Identification]
    grid: GridHeadings | None


def full_closure(reckoning: DeadReckoning, wrong_share: float = ROUNDS.wrong_share) -> Closed:
    """Identify the passes of a run, with headings by the grid of its building, if any."""
    return _in_rounds(_Closure(reckoning, grid_headings(reckoning), wrong_share))


def closure_without_grid(reckoning: DeadReckoning) -> Closed:
    """Identify the passes of a run without headings by a grid."""
    return _in_rounds(_Closure(reckoning, None, ROUNDS.wrong_share))


def unclosed(reckoning: DeadReckoning) -> Closed:
    """The run with every pass at a place of its own."""
    place = np.arange(len(reckoning), dtype=np.int64)
    return Closed(reckoning, place, optimise(reckoning, place), identifications=[], grid=None)


def _in_rounds(closure: _Closure) -> Closed:
    # Terminates: every round but the first adds an identification or is the last, and those taken
    # back are blocked.
    for number in count(1):
        identifications = closure.certain(number)
        if identifications:
            closure.identify(identifications)
            closure.fit_noise()
            closure.take_back_outliers(number)
        elif number > 1:
            break
    return closure.result()


class _Closure:
    """The state of a closure: identifications and refusals, and the present estimate."""

    def __init__(
        self, reckoning: DeadReckoning, grid: GridHeadings | None, wrong_share: float
    ) -> None:
        self._grid = grid
        self._least_odds = needed_odds(len(reckoning), wrong_share)
        self._reckoning = self._unscaled = scale_noise(reckoning, ROUNDS.caution)
        self._scale = 1.0
        self._corridors: GridCorridors | None = None
        self._identifications: list[Identification] = []
        self._blocked: set[tuple[int, int]] = set()
        self._refused: list[Identification] = []
        self._taken_back: list[Identification] = []
        self._place = np.arange(len(reckoning), dtype=np.int64)
        self._estimate = self._optimised(None)

    def certain(self, number: int) -> list[Identification]:
        """The identifications that are certain by the present estimate: individually or, if there
        are none, jointly. The first round uses cheap bounds of the covariances, and makes only
        clear identifications."""
        exact = number > 1
        state = self._map_state()
        found = candidates(state, self._place, self._estimate, exact=exact)
        found = take(found, ~_blocked(found, self._blocked, self._place))
        certain_now = _certain(state.places, found, self._least_odds)
        found = take(found, found.fits)
        agreement = NO_AGREEMENT
        if not certain_now and exact:
            agreement = jointly_certain(
                self._estimate, found, state.common, least_odds=self._least_odds
            )
            certain_now = _together(state.places, found, agreement)
        refused = _refused(state.places, found, agreement, self._least_odds)
        self._refused = [replace(q, round=number) for q in refused]
        return [replace(q, round=number) for q in certain_now]

    def identify(self, identifications: list[Identification]) -> None:
        """Identify these passes, and optimise the pose graph again."""
        self._identifications += identifications
        turn = self._estimate.pose[:, 2] + _alignment_turns(self._place, identifications)
        self._place = _partition(len(self._reckoning), self._identifications)
        self._estimate = self._optimised(self._estimate.pose, turn)

    def fit_noise(self) -> None:
        """Raise the noise if the residuals of the estimate are significantly larger."""
        scale = _fitting_scale(self._scale, self._estimate)
        if scale != self._scale:
            self._scale, self._reckoning = scale, scale_noise(self._unscaled, scale)
            self._estimate = self._optimised(self._estimate.pose)

    def take_back_outliers(self, number: int) -> None:
        """Undo and block the identifications that the estimate contradicts."""
        outliers = _outliers(self._place, self._estimate, self._identifications)
        if not outliers:
            return
        self._blocked |= {(q.first, q.second) for q in outliers}
        self._taken_back += [
            replace(q, accepted=False, reason=TORN, round=number, accepted_round=q.round)
            for q in outliers
        ]
        self._identifications = [q for q in self._identifications if q not in outliers]
        self._place = _partition(len(self._reckoning), self._identifications)
        self._estimate = self._optimised(self._estimate.pose)

    def result(self) -> Closed:
        """The closed run, once nothing more is certain."""
        if self._corridors is not None:
            # Straight corridors only help to identify; the map has them as they were measured.
            self._corridors = None
            self._estimate = self._optimised(self._estimate.pose)
        place = self._place
        refused = [q for q in self._taken_back + self._refused if place[q.first] != place[q.second]]
        identifications = self._identifications + refused
        return Closed(self._reckoning, place, self._estimate, identifications, self._grid)

    def _map_state(self) -> MapState:
        """The state of the map at the present estimate.

        If the map repeats itself, branches and corridors are weak evidence and position must
        decide: the estimate is first improved by constraining grid corridors to be straight.
        """
        state = map_state(self._reckoning, self._place, self._estimate)
        if self._grid is None or not state.common.lattice.repeats:
            return state
        if self._corridors is None:
            turn, core_m = self._estimate.pose[:, 2], state.common.core_m
            self._corridors = grid_corridors(self._reckoning, self._grid, turn, core_m)
        self._estimate = self._optimised(self._estimate.pose)
        return map_state(self._reckoning, self._place, self._estimate)

    def _optimised(self, start: FloatArray | None, turn: FloatArray | None = None) -> Estimate:
        return optimise(
            self._reckoning,
            self._place,
            start,
            turn=turn,
            grid=self._grid,
            corridors=self._corridors,
        )


def map_state(reckoning: DeadReckoning, place: IntArray, estimate: Estimate) -> MapState:
    """The state of the map at an estimate of its places."""
    places = tabulate(reckoning, place, estimate.pose[:, 2])
    noise = measured_rates(places, reckoning.noise)
    common = background(reckoning, noise)
    lattice = lattice_of(places, estimate.xy, core_m=common.core_m, typical_m=common.leg_m)
    common = replace(common, lattice=lattice)
    return MapState(reckoning, places, estimate.xy, common, branches_of(places, common))


def _fitting_scale(scale: float, estimate: Estimate) -> float:
    """The factor on the noise, raised if residuals are significantly too large (χ² gate)."""
    if estimate.reduced_chi2 * estimate.freedom > LIKELIHOOD.gate_chi2(estimate.freedom):
        return scale * float(np.sqrt(estimate.reduced_chi2))
    return scale


def _blocked(found: Candidates, blocked: set[tuple[int, int]], place: IntArray) -> BoolArray:
    """(k,) whether a candidate's identification was taken back before."""
    pairs = {frozenset((int(place[i]), int(place[j]))) for i, j in blocked}
    ends = zip(found.a.tolist(), found.b.tolist(), strict=True)
    return np.array([frozenset(pair) in pairs for pair in ends], bool)


def _partition(count: int, links: list[Identification]) -> IntArray:
    """(p,) places as connected components of the links, numbered by first visit."""
    i = np.array([q.first for q in links], np.int64)
    j = np.array([q.second for q in links], np.int64)
    return connected(i, j, count)


def _alignment_turns(place: IntArray, identifications: list[Identification]) -> FloatArray:
    """(p,) rotations that align the branches of newly identified places [rad], propagated along the
    identifications. place: (p,) before these."""
    links_of: dict[int, list[tuple[int, float]]] = {}
    for q in identifications:
        a, b = int(place[q.first]), int(place[q.second])
        links_of.setdefault(a, []).append((b, q.turn_rad))
        links_of.setdefault(b, []).append((a, -q.turn_rad))
    turn = np.zeros(int(place.max(initial=-1)) + 1)
    visited: set[int] = set()
    for root in sorted(links_of):
        if root in visited:
            continue
        visited.add(root)
        stack = [root]
        while stack:
            a = stack.pop()
            for b, step in links_of[a]:
                if b not in visited:
                    visited.add(b)
                    turn[b] = turn[a] + step
                    stack.append(b)
    return np.asarray(turn[place])


def _certain(places: Places, found: Candidates, least_odds: float) -> list[Identification]:
    """The candidates whose log odds against all they exclude reach `least_odds`, best first.

    "a is b" excludes "a is c" unless b may be c, too.
    """
    total, ends = found.total, np.stack([found.a, found.b], axis=1).tolist()
    positive = np.flatnonzero(total >= 0.0).tolist()
    possible = {frozenset(ends[k]) for k in positive}
    likely = [k for k in positive if found.fits[k]]
    by_place: dict[int, list[int]] = defaultdict(list)
    for k in likely:
        for place in ends[k]:
            by_place[place].append(k)
    certain = []
    for k in sorted(likely, key=lambda k: (-total[k], k)):
        if total[k] < least_odds:
            break
        near = {other for place in ends[k] for other in by_place[place]} - {k}
        # What two candidates do not share, one place of each, are two places unless it is possible.
        rivals = sorted(j for j in near if frozenset(ends[k]) ^ frozenset(ends[j]) not in possible)
        if total[k] - np.logaddexp.reduce([0.0, *total[rivals]]) >= least_odds:
            certain.append(
                _identification(places, found, k, float(total[k]), reason=AGREE, accepted=True)
            )
    return certain


def _together(places: Places, found: Candidates, agreement: Agreement) -> list[Identification]:
    """The candidates that are certain only jointly."""
    return [
        _identification(places, found, row, value, reason=TOGETHER, accepted=True)
        for row, value in zip(agreement.rows.tolist(), agreement.odds.tolist(), strict=False)
    ]


def _identification(
    places: Places, found: Candidates, row: int, odds: float, *, reason: str, accepted: bool
) -> Identification:
    """A candidate as an accepted or refused identification of two passes."""
    i, j = int(places.first[found.a[row]]), int(places.first[found.b[row]])
    turn = float(found.around.turn[row])
    if i > j:
        i, j, turn = j, i, -turn
    return Identification(i, j, accepted, odds / BIT, reason, turn)


def _outliers(
    place: IntArray, estimate: Estimate, links: list[Identification]
) -> list[Identification]:
    """The identifications to take back: for each place with an observation that the estimate
    rejects (χ² gate), the weakest ones that split the place in two."""
    suspect = set(
        place[estimate.sighting[estimate.sighting_chi2 > LIKELIHOOD.gate_chi2(3)]].tolist()
    )
    links_of: dict[int, list[Identification]] = {p: [] for p in sorted(suspect)}
    for q in links:
        if int(place[q.first]) in suspect:
            links_of[int(place[q.first])].append(q)
    return [q for links_here in links_of.values() for q in weakest_cut(links_here)]


def weakest_cut(links: list[Identification]) -> list[Identification]:
    """The links between the last two parts of a place, if parts are merged in order of their
    strongest link (single linkage)."""
    passes = sorted({i for q in links for i in (q.first, q.second)})
    part = {i: i for i in passes}
    parts = len(passes)
    for q in sorted(links, key=lambda q: (-q.bits, q.first, q.second)):
        a, b = part[q.first], part[q.second]
        if a == b:
            continue
        if parts == 2:
            return [r for r in links if part[r.first] != part[r.second]]
        part = {i: a if p == b else p for i, p in part.items()}
        parts -= 1
    return []


def _refused(
    places: Places, found: Candidates, agreement: Agreement, least_odds: float
) -> list[Identification]:
    """The candidates with some evidence as refused identifications, with the reasons."""
    total, refused = found.total, []
    refused_together = set(agreement.rows.tolist()) if agreement.reason else set()
    for k in np.flatnonzero(found.position + found.around.branches > 0).tolist():
        if found.around.conflict[k] > 2:
            reason = DISAGREE
        elif total[k] + found.aliasing_penalty[k] >= least_odds > total[k]:
            reason = COMMON
        else:
            reason = agreement.reason if k in refused_together else UNSURE
        refused.append(
            _identification(places, found, k, float(total[k]), reason=reason, accepted=False)
        )
    return refused
