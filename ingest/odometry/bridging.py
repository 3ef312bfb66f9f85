"""Sizes of the odometry's jumps, measured by places seen on both sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.closure.dead_reckoning import DeadReckoning
from ...topology.closure.estimate import Estimate
from ...topology.closure.incremental import Closed
from ...topology.odometry import Odometry
from ...topology.se2 import between, compose, inverse, wrap
from .jumps import driven_on

CLEAR_RAD = np.pi / 12
"""1 sigma of a rotation that is known to less than an eighth of a turn (3 sigma): the grid of a
building can be followed across it, and branches are not confused."""
CLEAR_LEGS = 0.5
"""1 sigma of a step, in median distances of neighbouring junctions, across which places are not
confused."""
LEAST_PLACES = 2
"""Least number of places seen on both sides: one may be a mistake."""


def bridged(
    odometry: Odometry,
    reckoning_of: Callable[[Odometry], DeadReckoning],
    close: Callable[[DeadReckoning], Closed],
) -> Odometry:
    """The odometry with the size of every jump known, or broken there.

    reckoning_of: dead reckoning of an odometry; close: loop closure, without the grid of the
    building, whose right angles fit every quarter turn. A jump that is small beside the distances
    of places and branches is left as it is, with its uncertainty. Of a larger one several cases are
    tried (`_cases`), in which places seen on both sides determine the step. If they do so in none,
    or the results disagree, the odometry is broken there. Closes the loops up to four times if
    there are large jumps.
    """
    reckoning = reckoning_of(odometry)
    leg = _legs(odometry, reckoning)
    open_ = _unclear(odometry, reckoning, leg)
    if not open_.any():
        return odometry
    # The cases lie half of the jump apart. Each covers a quarter of its turn to either side (1
    # sigma), but half of its way, which need not be straight.
    covered = np.where(open_[:, None], [0.5, 0.25] * odometry.jump_sigma, odometry.jump_sigma)
    cases = _cases(replace(odometry, jump_sigma=covered), open_)
    found = [_steps(case, reckoning_of, close, open_) for case in cases]
    agreed = {row: step for row in {*chain(*found)} if (step := _agreed(found, row))}
    rows = np.array(sorted(agreed), np.int64)
    known = np.isin(odometry.jumps, rows) if len(rows) else np.zeros(len(open_), bool)
    steps = np.array([agreed[row].step for row in rows.tolist()]).reshape(-1, 3)
    bridged = _driven(odometry, known, steps)
    # The measured steps keep the sigma of their case, as far as it is usable, because the
    # identifications that they rest on are made again.
    same_leg = np.isin(leg, leg[known])
    clear = np.minimum(covered, [_clear_m(reckoning), CLEAR_RAD])
    sigma = np.where(same_leg[:, None], clear, odometry.jump_sigma)
    breaks = np.union1d(odometry.breaks, odometry.jumps[open_ & ~same_leg])
    return replace(bridged, jump_sigma=sigma, breaks=breaks)


def confirmed(
    recorded: Odometry, odometry: Odometry, reckoning: DeadReckoning, place: IntArray
) -> Odometry:
    """The `bridged` odometry, broken at jumps that its places, identified anew, do not confirm.

    If the places that determined a step were misidentified, none of them is seen on both sides once
    the step is applied: the parts before and after it would be joined by a mistake.
    """
    leg = _legs(odometry, reckoning)
    measured = _unclear(recorded, reckoning, leg)
    alone = [m and _shared(place, k) < LEAST_PLACES for m, k in zip(measured, leg, strict=True)]
    return replace(odometry, breaks=np.union1d(odometry.breaks, odometry.jumps[np.array(alone)]))


def jump_records(recorded: Odometry, odometry: Odometry) -> list[dict[str, Any]]:
    """For the document: time and size of the odometry's jumps, and whether it is split there.

    recorded: as read; odometry: `bridged`, with the same rows.
    """
    rows = recorded.jumps
    step = between(recorded.pose[rows - 1], recorded.pose[rows])
    off = recorded.jump_other - step
    return [
        {
            "time_ns": time_ns,
            "shift_m": round(float(np.hypot(x, y)), 3),
            "turn_rad": round(abs(float(wrap(turn))), 3),
            "split": split,
        }
        for time_ns, (x, y, turn), split in zip(
            recorded.time_ns[rows].tolist(), off, _split(odometry).tolist(), strict=True
        )
    ]


def describe_splits(recorded: Odometry, odometry: Odometry) -> list[str]:
    """A warning on the jumps of unknown size, if there are any."""
    rows = recorded.jumps[_split(odometry)]
    if len(rows) == 0:
        return []
    seconds = (recorded.time_ns[rows] - recorded.time_ns[0]) * 1e-9
    at = ", ".join(f"{second:.1f} s" for second in seconds)
    return [
        f"{len(rows)} {'jump' if len(rows) == 1 else 'jumps'} of the odometry (at {at}) not agreed "
        "by places seen before and after: the chain is split there"
    ]


def _split(odometry: Odometry) -> BoolArray:
    return np.isin(odometry.jumps, odometry.breaks)


def _legs(odometry: Odometry, reckoning: DeadReckoning) -> IntArray:
    """(j,) leg that each jump falls in, by the pass before it; -1 if there is none."""
    leg = np.searchsorted(reckoning.passes.time_ns, odometry.time_ns[odometry.jumps]) - 1
    inside = (leg >= 0) & (leg < len(reckoning) - 1)
    inside &= np.append(np.diff(reckoning.piece) == 0, False)[leg]
    return np.where(inside, leg, -1)


def _unclear(odometry: Odometry, reckoning: DeadReckoning, leg: IntArray) -> BoolArray:
    """(j,) whether places may be confused across a jump."""
    sigma = odometry.jump_sigma
    return np.asarray(
        (leg >= 0) & ((sigma[:, 0] > _clear_m(reckoning)) | (sigma[:, 1] > CLEAR_RAD))
    )


def _clear_m(reckoning: DeadReckoning) -> float:
    known = reckoning.leg[np.isfinite(reckoning.leg)]
    return CLEAR_LEGS * float(np.median(known)) if len(known) else 0.0


def _cases(odometry: Odometry, open_: BoolArray) -> list[Odometry]:
    """The odometry with the open jumps as if the robot had driven on, had moved as the odometry
    says (`Odometry.jump_other`), or had moved half of that, its frame having jumped by the rest.

    Half of a turn goes either way round: the odometry shows turns up to whole ones only. The longer
    way is tried if it is no larger than the jump itself.
    """
    rows = odometry.jumps[open_]
    on = between(odometry.pose[rows - 1], odometry.pose[rows])
    off = odometry.jump_other[open_] - on
    off[:, 2] = wrap(off[:, 2])
    half, turn = on + off / 2, np.abs(off[:, 2])
    steps = [on, on + off, half]
    longer = np.pi - turn / 2 <= turn
    if longer.any():
        steps.append(half + np.outer(longer, [0.0, 0.0, np.pi]))
    return [_driven(odometry, open_, step) for step in steps]


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """A jump as measured by places: step: (3,) of the robot [m, m, rad]; sigma: (2,) [m per axis,
    rad]; places: number seen on both sides."""

    step: FloatArray
    sigma: FloatArray
    places: int

    def fits(self, step: FloatArray, spare: FloatArray) -> bool:
        """Whether another step differs by at most `spare` [m, rad] plus three sigmas of this
        one."""
        off = between(self.step, step)
        apart = np.array([np.hypot(off[0], off[1]), abs(off[2])])
        return bool(np.all(apart <= spare + 3 * self.sigma))


def _steps(
    case: Odometry,
    reckoning_of: Callable[[Odometry], DeadReckoning],
    close: Callable[[DeadReckoning], Closed],
    open_: BoolArray,
) -> dict[int, _Step]:
    """The motion over jumps as measured in one case, by odometry row, where places determine it.

    Legs with an open jump have at most one, at their first jump. open_: (j,) jumps to measure;
    reckoning_of, close: as in `bridged`.
    """
    reckoning = reckoning_of(case)
    leg = _legs(case, reckoning)
    closed = close(reckoning)
    clear = np.array([_clear_m(reckoning), CLEAR_RAD])
    out = {}
    legs = np.unique(leg[open_ & (leg >= 0)])
    cov = closed.estimate.relative_covariance(legs, legs + 1)
    for k, c in zip(legs.tolist(), cov, strict=True):
        jump = int(np.flatnonzero(leg == k)[0])
        row = int(case.jumps[jump])
        sigma = np.sqrt(np.array([0.5 * (c[0, 0] + c[1, 1]), c[2, 2]]))
        places = _shared(closed.place, k)
        T_before_after = compose(
            inverse(_frame(reckoning, closed.estimate, k)),
            _frame(reckoning, closed.estimate, k + 1),
        )
        moved = between(case.pose[row - 1], compose(T_before_after, case.pose[row]))
        found = _Step(moved, sigma, places)
        taken = between(case.pose[row - 1], case.pose[row])
        # The odometry's error is at most the size of the jump: two sigmas of the case.
        likely = found.fits(taken, 2 * case.jump_sigma[jump])
        if likely and bool(np.all(sigma < clear)) and places >= LEAST_PLACES:
            out[row] = found
    return out


def _agreed(found: list[dict[int, _Step]], row: int) -> _Step | None:
    """The step measured in several cases, that of most places; None if another one contradicts
    it."""
    best, *others = sorted((case[row] for case in found if row in case), key=lambda s: -s.places)
    return best if all(best.fits(other.step, 3 * other.sigma) for other in others) else None


def _shared(place: IntArray, leg: int) -> int:
    """Number of places seen on both sides of a leg."""
    return len(np.intersect1d(place[: leg + 1], place[leg + 1 :]))


def _frame(reckoning: DeadReckoning, estimate: Estimate, i: int) -> FloatArray:
    """T_map_odom at pass i."""
    x, y = reckoning.passes.centre[i]
    return compose(estimate.pose[i], [-x, -y, 0.0])


def _driven(odometry: Odometry, chosen: BoolArray, step: FloatArray) -> Odometry:
    """The odometry with the steps of the chosen jumps replaced."""
    return replace(odometry, pose=driven_on(odometry.pose, odometry.jumps[chosen], step))
