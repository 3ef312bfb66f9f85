"""Nearest-neighbour gating: each pass joins the only known place within the error of dead
reckoning.

One pass at a time, in order, without optimising the pose graph. It requires the same log odds as
full closure, but ignores the corridors around, and finds little once the drift exceeds the distance
between junctions. A baseline for comparison (`--closure gated`).
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray
from ..matching.likelihood import BIT, LIKELIHOOD
from .answers import Identification
from .branches import align, branches_of
from .dead_reckoning import DeadReckoning, dead_reckoning_covariance, scale_noise
from .estimate import optimise
from .evidence import background, position_odds
from .growth import MapState
from .incremental import Closed, RoundSettings
from .places import tabulate


def gated_closure(reckoning: DeadReckoning, settings: RoundSettings) -> Closed:
    """The run closed by nearest-neighbour gating, with every identification considered.

    O(p · places), vectorised over the places.
    """
    count = len(reckoning)
    state = _scene(scale_noise(reckoning, settings.caution), settings)
    least = settings.least_odds(count)
    place = np.full(count, -1, np.int64)
    latest = np.zeros(count, np.int64)  # last pass by each place
    identifications: list[Identification] = []
    places = 0
    for i in range(count):
        known = latest[:places]
        known = known[reckoning.piece[known] == reckoning.piece[i]]
        odds = _odds(state, known, i)
        order = np.argsort(-odds, kind="stable")
        if len(order) and odds[order[0]] > 0:
            best, first = int(known[order[0]]), float(odds[order[0]])
            # The alternatives include a place not seen before (odds 0).
            others = float(np.logaddexp.reduce(odds[order[1:]], initial=0.0))
            enough = first >= least
            sure = first - others >= least
            reason = "nearest place" if sure else "a rival is as near" if enough else "weak"
            identifications.append(Identification(best, i, sure, first / BIT, reason))
            if sure:
                place[i] = place[best]
        if place[i] < 0:
            place[i] = places
            places += 1
        latest[place[i]] = i
    return Closed(reckoning, place, optimise(reckoning, place), identifications, None)


def _scene(reckoning: DeadReckoning, settings: RoundSettings) -> MapState:
    """Every pass as a place of its own."""
    count, evidence = len(reckoning), settings.candidates.evidence
    places = tabulate(reckoning, np.arange(count), np.zeros(count))
    common = background(reckoning, reckoning.noise, evidence)
    branches = branches_of(places, common, evidence)
    return MapState(reckoning, places, reckoning.passes.centre, common, branches)


def _odds(state: MapState, known: IntArray, i: int) -> FloatArray:
    """(k,) log odds that pass i was by the place of each known pass, by position and branches."""
    common = state.common
    here = np.full(len(known), i, np.int64)
    cov = dead_reckoning_covariance(state.reckoning, known, here)
    spread = cov[:, :2, :2] + 2 * common.centre_sigma**2 * np.eye(2)
    odds, d2 = position_odds(common, state.xy[known] - state.xy[i], spread)
    near = np.flatnonzero(d2 < LIKELIHOOD.gate_chi2(2))
    turn_sigma = np.sqrt(cov[near, 2, 2])
    out = np.full(len(known), -np.inf)
    fit = align(state.branches, known[near], here[near], turn_sigma=turn_sigma)
    out[near] = odds[near] + fit.odds
    return out
