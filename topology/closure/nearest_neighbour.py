"""The simple closure: each pass joins the nearest known place that dead reckoning allows.

One look per pass, in the order of time; nothing is taken back. It is honest – a pass joins only
where the odometry's covariance, the branches and the lack of a rival leave no doubt – but finds
little once the drift outgrows the distance between junctions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..se2 import wrap
from .dead_reckoning import Walk, dead_reckoning_covariance

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class GatedSettings:
    """What counts as "no doubt"."""

    least_bits: float = 5.0
    """Evidence that an identification needs."""
    lead_bits: float = 4.0
    """Evidence that it must have over every other candidate."""
    gate: float = 12.0
    """Largest squared Mahalanobis distance of a candidate."""
    branch_fault_bits: float = 4.0
    """Price of each branch that only one of the two has."""


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Passes `first` and `second` were asked to be one place.

    turn_rad: by how much the branches around `second` had to be turned to meet those around
    `first`, on top of the layout at that time. round: in which the answer was given, from 1 on; 0
    if not by rounds. accepted_round: in which it had been accepted, if this takes it back.
    """

    first: int
    second: int
    accepted: bool
    bits: float
    reason: str
    turn_rad: float = 0.0
    round: int = 0
    accepted_round: int | None = None


def gated_closure(
    walk: Walk, settings: GatedSettings = GatedSettings()
) -> tuple[IntArray, list[Identification]]:
    """(p,) place of every pass, numbered by first visit, and the questions that were asked.

    O(p · places), vectorised over the places.
    """
    count = len(walk)
    place = np.full(count, -1, np.int64)
    latest = np.zeros(count, np.int64)  # last pass by each place
    asked: list[Identification] = []
    density = _place_density(walk)
    places = 0
    for i in range(count):
        candidates = latest[:places]
        candidates = candidates[walk.chain[candidates] == walk.chain[i]]
        bits = _evidence_bits(walk, candidates, i, density, settings)
        order = np.argsort(-bits, kind="stable")
        if len(order) and bits[order[0]] > 0:
            best = int(candidates[order[0]])
            lead = bits[order[0]] - max(bits[order[1]] if len(order) > 1 else -np.inf, 0.0)
            enough = bits[order[0]] >= settings.least_bits
            sure = bool(enough and lead >= settings.lead_bits)
            reason = "nearest place" if sure else "a rival is as near" if enough else "weak"
            asked.append(Identification(best, i, sure, float(bits[order[0]]), reason))
            if sure:
                place[i] = place[best]
        if place[i] < 0:
            place[i] = places
            places += 1
        latest[place[i]] = i
    return place, asked


def _place_density(walk: Walk) -> float:
    """Places per square metre, as if they filled the box that was driven."""
    extent = np.ptp(walk.passes.centre, axis=0) + 5.0
    return len(walk) / 2.0 / float(extent.prod())


def _evidence_bits(
    walk: Walk, candidates: IntArray, i: int, density: float, settings: GatedSettings
) -> FloatArray:
    """(k,) evidence that pass i was by the place of each candidate pass [bits]."""
    if len(candidates) == 0:
        return np.zeros(0)
    here = np.full(len(candidates), i, np.int64)
    cov = dead_reckoning_covariance(walk, candidates, here)
    s = cov[:, :2, :2] + 2 * walk.noise.centre_m**2 * np.eye(2)
    d = walk.passes.centre[i] - walk.passes.centre[candidates]
    det = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] ** 2
    d2 = (
        s[:, 1, 1] * d[:, 0] ** 2 - 2 * s[:, 0, 1] * d[:, 0] * d[:, 1] + s[:, 0, 0] * d[:, 1] ** 2
    ) / det
    nats = -0.5 * d2 - np.log(2 * np.pi * np.sqrt(det)) - np.log(density)
    bits: FloatArray = nats / np.log(2)
    bits[d2 > settings.gate] = -np.inf
    near = np.flatnonzero(bits > -20)
    for k in near:
        sigma = np.sqrt(2 * walk.noise.branch_rad**2 + cov[k, 2, 2])
        bits[k] += _signature_bits(walk, int(candidates[k]), i, float(sigma), settings)
    return bits


def _signature_bits(walk: Walk, a: int, b: int, sigma: float, settings: GatedSettings) -> float:
    """Evidence of two branch sets: gain for each pair that agrees, price for each left over."""
    off = np.abs(wrap(walk.passes.branches[a][:, None] - walk.passes.branches[b][None, :]))
    mutual = (off == off.min(axis=0, keepdims=True)) & (off == off.min(axis=1, keepdims=True))
    agree = mutual & (off < max(3 * sigma, 0.2)) & (off < 0.7)
    pairs = int(agree.sum())
    left = off.shape[0] + off.shape[1] - 2 * pairs
    # A branch of some other place falls into the gate one time in four or so: streets cross at
    # right angles.
    return float(pairs * 0.7 - left * settings.branch_fault_bits)
