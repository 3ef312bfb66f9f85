"""The second question: this place, or another copy of the same design?

Where a building repeats itself, "better than chance" says little: the wrong wing, too, is much
better than chance. What tells the place from its copy is that two looks at one place differ by
measurement noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .branches import lonely_branches
from .prepare import FloatArray, IntArray, Prepared
from .settings import RobustSettings

if TYPE_CHECKING:
    from .alignment import Candidate

NOISE_FACTORS = np.exp(np.linspace(np.log(0.5), np.log(2.0), 13))
"""The noise that a run reports may be wrong by such factors; both answers may choose."""

PRIOR_SAMPLES = 40.0
MOST_FAULTS = 0.3

NOISE_DOUBT = 0.3
"""1 sigma of the logarithm of that factor."""

WORST_NATS = 8.0
"""No single corridor decides: it may have been measured past a junction."""


@dataclass(frozen=True, slots=True)
class Sameness:
    """bits: log2 odds of "the same place" against "another copy"; its parts: shape, changes;
    compared: junctions compared, changed: how many of them differ."""

    bits: float
    shape: float
    changes: float
    compared: int
    changed: int


@dataclass(frozen=True, slots=True)
class CopyModel:
    """How copies of one design differ: relative 1 sigma of lengths, share of changed junctions."""

    variation: float
    change_rate: float


def sameness(a: Prepared, b: Prepared, best: Candidate, copies: CopyModel) -> Sameness:
    """Odds of the same place against a copy of it, by what copies differ in: shape and changes.

    Shape: the lengths of common corridors. Changes: junctions that differ in their branches, or
    that only one map has, come at the runs' fault rates in one place, more often between copies.
    """
    shape = _shape_bits(a, b, best.corridors, copies)
    lonely = lonely_branches(a, b, best.a, best.b, best.turn)
    changed = int(np.count_nonzero(lonely)) + len(best.conflicts)
    compared = len(best) + len(best.conflicts)
    fault = float((a.fault_rate[best.a] + b.fault_rate[best.b]).sum() / len(best))
    fault = min(fault, MOST_FAULTS)
    copy = fault + (1 - fault) * copies.change_rate
    changes = (compared - changed) * np.log2((1 - fault) / (1 - copy))
    changes += changed * np.log2(fault / copy)
    return Sameness(shape + float(changes), shape, float(changes), compared, changed)


def _shape_bits(a: Prepared, b: Prepared, corridors: IntArray, copies: CopyModel) -> float:
    """log2 likelihood ratio of the differences of the lengths of all common corridors.

    Same place: measurement noise, scaled by a factor that is unknown within a prior. Copy: on top
    of it what two copies were built unlike. Both integrate over the factor.
    """
    i, j = corridors[:, 0], corridors[:, 1]
    d2 = (a.length[i] - b.length[j]) ** 2
    noise = (a.variance[i] + b.variance[j]) * NOISE_FACTORS[:, None] ** 2
    built = 2 * (copies.variation * np.maximum(a.length[i], b.length[j])) ** 2
    prior = -0.5 * (np.log(NOISE_FACTORS) / NOISE_DOUBT) ** 2

    def likelihood(variance: FloatArray) -> float:
        terms = -0.5 * np.log(variance) - np.minimum(0.5 * d2 / variance, WORST_NATS)
        return float(np.logaddexp.reduce(terms.sum(axis=1) + prior))

    return (likelihood(noise) - likelihood(noise + built)) / float(np.log(2))


def copy_model(
    samples: Sequence[tuple[Prepared, Candidate]], settings: RobustSettings
) -> CopyModel:
    """How copies differ, learned from maps that match themselves elsewhere.

    Learning only ever makes copies more alike than the settings say, never less: a building whose
    wings were built to the millimetre must raise the bar, a loose self-match must not lower it.
    Both estimates are shrunk towards the settings as by `PRIOR_SAMPLES` more samples.
    """
    prior = CopyModel(settings.copy_variation, settings.copy_change_rate)
    excess = settings.copy_variation**2 * PRIOR_SAMPLES
    changed = settings.copy_change_rate * PRIOR_SAMPLES
    lengths = places = PRIOR_SAMPLES
    for m, c in samples:
        i, j = c.corridors[:, 0], c.corridors[:, 1]
        d2 = (m.length[i] - m.length[j]) ** 2 - m.variance[i] - m.variance[j]
        relative = d2 / (2 * np.maximum(m.length[i], m.length[j]) ** 2)
        excess += float(np.clip(relative, 0.0, settings.copy_variation**2).sum())
        lengths += len(i)
        same = sameness(m, m, c, prior)
        fault = 2 * float(np.mean(m.fault_rate))
        changed += max(same.changed - fault * same.compared, 0.0)
        places += same.compared
    return CopyModel(
        min(settings.copy_variation, float(np.sqrt(excess / lengths))),
        min(settings.copy_change_rate, changed / places),
    )
