"""The test for copies: is this the same place, or another copy of the same design?

Where a building repeats itself, a match with the wrong wing is much better than chance, too. But
two measurements of one place differ by noise alone, while two copies differ by more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined
from ...topology.matching.likelihood import BIT, LIKELIHOOD
from .atlas import Atlas
from .branches import unpaired_branches
from .prepare import Prepared
from .settings import MATCH, RobustSettings

if TYPE_CHECKING:
    from .alignment import Candidate


@dataclass(frozen=True, slots=True)
class CopySettings:
    """Assumptions on copies, beside `copy_variation` and `copy_change_rate`."""

    exact_prior: tuple[float, ...] = (0.15, 0.25, 0.26, 0.22, 0.119, 0.001)
    """Prior of the share of corridors that two copies have built exactly alike, from none to all in
    equal steps: two fifths on average. It holds before any map has shown how exactly it repeats
    itself. Conservative: with it offices keep the promised rate (`benchmarks/calibration.py`)."""
    most_changed: float = 0.5
    """Upper bound of the share of junctions that differ between copies. Many matches of maps with
    themselves are chance, not copies, and show more (`benchmarks/calibration.py`). Also the upper
    bound of the detectors' fault rate: beyond, changes would carry no information. Tried: .3, no
    change in simulated worlds, but of 102 pairs of saved maps and logs 6 are kept apart."""
    most_stated: float = 0.3
    """Fault rates beyond this one are bounded by the changes that the alignment shows. Such rates
    are stated by saved maps, which contain doors and furniture of other times. They are upper
    bounds: measured by them, any two maps of one plan would be the same place. Without it maps of
    offices of one plan, drawn without noise, are merged (`benchmarks/grids.py`)."""


COPIES = CopySettings()

ROUNDING_NATS = np.sqrt(np.finfo(float).eps)
"""Rounding error of the bound, which is 0 for a typical copy and never negative."""

WORST_NATS = LIKELIHOOD.most
"""Bound on the evidence of a single corridor: it may have been measured past a junction."""

TOGETHER = 2**6
"""Alignments of a batch, which fits the processor's cache."""

TILTS = np.concatenate([np.linspace(0.0, 1.0, 6), [1.25, 1.6, 2.0, 2.5, 3.2, 4.0]])
"""Exponents tried in the Chernoff bound."""

NODES, NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(17)
NODES, NODE_WEIGHTS = NODES[8:], NODE_WEIGHTS[8:] * [1, *[2] * 8]
NODE_WEIGHTS = NODE_WEIGHTS / NODE_WEIGHTS.sum()
"""Gauss-Hermite quadrature of even functions: each node stands for two."""

SHARES = np.linspace(0.0, 1.0, len(COPIES.exact_prior))
"""Shares of corridors built exactly alike that `exact_prior` refers to."""


@dataclass(frozen=True, slots=True)
class Sameness:
    """Result of the test for copies. bits: -log2 of an upper bound of the probability that a copy
    agrees as well, negative where a typical copy agrees better; compared: number of junctions
    compared; changed: number of these that differ."""

    bits: float
    compared: int
    changed: int


@dataclass(frozen=True, slots=True)
class CopyModel:
    """How copies of one design differ.

    variation: relative 1 sigma of lengths not built exactly alike; exact_odds: probability of each
    of the `SHARES`; change_rate: share of junctions that differ.
    """

    variation: float
    exact_odds: tuple[float, ...]
    change_rate: float


def default_copies(settings: RobustSettings) -> CopyModel:
    """The prior copy model."""
    return CopyModel(settings.copy_variation, COPIES.exact_prior, settings.copy_change_rate)


def sameness(
    cases: Sequence[tuple[Prepared, Prepared, Candidate]], copies: CopyModel
) -> Iterator[Sameness]:
    """Evidence that alignments are of one place and not of copies, from lengths and changes.

    Lengths: differences of common corridors. Changes: junctions that differ in their branches, or
    that only one map has. In one place these occur at the runs' fault rates, between copies more
    often. The statistic T is the log likelihood ratio of the two, a sum over corridors and
    junctions. The result is a Chernoff bound of the probability that a copy reaches it: the minimum
    over x of E[exp(x (T' - T))] with T' the statistic of a copy (x = 1 gives the likelihood ratio
    itself, so that the bound is never worse).
    """
    for start in range(0, len(cases), TOGETHER):
        yield from _batch_sameness(cases[start : start + TOGETHER], copies)


def _batch_sameness(
    cases: Sequence[tuple[Prepared, Prepared, Candidate]], copies: CopyModel
) -> Iterator[Sameness]:
    matched = np.array([len(c) for _, _, c in cases])
    differing, expected = _count_differing(cases, np.cumsum([0, *matched]))
    conflicts = np.array([len(c.conflicts) for _, _, c in cases])
    changed, compared = differing + conflicts, matched + conflicts
    stated = np.minimum(expected, COPIES.most_changed)
    observed = np.minimum(stated, (changed + 1) / (compared + 1))
    fault = np.where(stated > COPIES.most_stated, observed, stated)
    change = fault + (1 - fault) * copies.change_rate
    same_nats, changed_nats = np.log((1 - fault) / (1 - change)), np.log(fault / change)
    lengths = [_Lengths.of(a, b, c.corridors, copies.variation) for a, b, c in cases]
    all_lengths, ends = joined(lengths), np.cumsum([0, *(len(part.d2) for part in lengths)])
    exact_share = float(np.dot(copies.exact_odds, SHARES))
    nats = _sums(all_lengths.odds(all_lengths.d2, exact_share), ends)
    nats += (compared - changed) * same_nats + changed * changed_nats
    tilts = TILTS[:, None]
    of_changes = compared * np.log(
        (1 - change) * np.exp(tilts * same_nats) + change * np.exp(tilts * changed_nats)
    )
    of_lengths = _sums(all_lengths.tilted(exact_share), ends)
    tilted = tilts * nats - of_changes - of_lengths  # (share, tilt, case)
    log_prior = np.log(copies.exact_odds)[:, None]
    bound = -np.logaddexp.reduce(log_prior - tilted.max(axis=1), axis=0)
    # Below the value of a typical copy the statistic itself is used, for ranking.
    bits = np.where(bound <= ROUNDING_NATS, np.minimum(nats, 0.0), bound) / BIT
    return map(Sameness, bits.tolist(), compared.tolist(), changed.tolist())


def _count_differing(
    cases: Sequence[tuple[Prepared, Prepared, Candidate]], ends: IntArray
) -> tuple[IntArray, FloatArray]:
    """For each alignment the number of matched junctions that differ in their branches, and the
    share expected from faults and confidences of the detectors. Without a matched junction, the
    latter is that of all junctions of the maps. ends: (cases + 1,) first match of each alignment.
    """
    atlas, rows = Atlas.of_pairs([(a, b) for a, b, _ in cases])
    first = atlas.vertex[rows.repeat(np.diff(ends), axis=0)]
    va = np.concatenate([c.a for _, _, c in cases]) + first[:, 0]
    vb = np.concatenate([c.b for _, _, c in cases]) + first[:, 1]
    turn = np.concatenate([c.turn for _, _, c in cases])
    differs = np.where(unpaired_branches(atlas.whole, atlas.whole, va, vb, turn) > 0, 1.0, 0.0)
    fault = atlas.whole.fault_rate[va] + atlas.whole.fault_rate[vb]
    fault += 1 - atlas.whole.confidence[va] * atlas.whole.confidence[vb]
    expected = _sums(fault, ends) / np.maximum(np.diff(ends), 1)
    expected += [0.0 if len(c) else _mean_fault_rate(a) + _mean_fault_rate(b) for a, b, c in cases]
    return _sums(differs, ends).astype(np.int64), expected


def _mean_fault_rate(m: Prepared) -> float:
    """Share of a map's junctions that may differ by faults of the detector or low confidence."""
    return float(np.mean(m.fault_rate + 1 - m.confidence))


def size_sigmas(pairs: Sequence[tuple[Prepared, Prepared, IntArray]]) -> float:
    """The difference in size of two places, in standard deviations, over pairs of their maps with
    the corridors that each has in common: (c, 2) matched directed rows.

    A copy of another size is larger throughout. Single corridors do not show this: each may be off
    by its odometry's scale. Generalised least squares: each pair measures the difference with the
    error of its lengths and the scale errors of its two maps, which other pairs share.
    """
    measured = [(a, b, *size_difference(a, b, corridors)) for a, b, corridors in pairs]
    measured = [row for row in measured if np.isfinite(row[3])]
    if not measured:
        return 0.0
    difference, variance = np.array([row[2:] for row in measured]).T
    maps = {id(m): m for a, b, *_ in measured for m in (a, b)}.values()
    sign = np.array([[float(m is a) - float(m is b) for m in maps] for a, b, *_ in measured])
    shared = sign * [m.noise.scale for m in maps]
    weight = np.linalg.solve(np.diag(variance) + shared @ shared.T, np.ones(len(measured)))
    return float(abs(weight @ difference) / np.sqrt(weight.sum()))


def size_difference(a: Prepared, b: Prepared, corridors: IntArray) -> tuple[float, float]:
    """Relative difference in size, a / b - 1, and its variance without the scale errors of the
    odometries; 0 and inf without corridors. corridors: (c, 2) matched directed rows."""
    i, j = corridors[:, 0], corridors[:, 1]
    length_a, length_b = a.length[i], b.length[j]
    difference, variance = length_a - length_b, a.variance[i] + b.variance[j]
    fits = np.abs(difference) < MATCH.length_sigmas * np.sqrt(variance)
    variance = variance - (a.noise.scale * length_a) ** 2 - (b.noise.scale * length_b) ** 2
    mean_length = (length_a + length_b) / 2
    weight = np.where(fits, mean_length**2 / variance, 0.0)
    total = float(weight.sum())
    if total == 0.0:
        return 0.0, np.inf
    return float((weight * difference / mean_length).sum()) / total, 1 / total


def _sums(values: FloatArray, ends: IntArray) -> FloatArray:
    """Sums over the last axis between consecutive `ends`; 0 for empty ranges."""
    filled = np.flatnonzero(np.diff(ends))
    sums = np.zeros((*values.shape[:-1], len(ends) - 1))
    if len(filled):
        sums[..., filled] = np.add.reduceat(values, ends[filled], axis=-1)
    return sums


@dataclass(frozen=True, slots=True, eq=False)
class _Lengths:
    """Length differences of c corridors.

    d2: (c,) squared differences [m²]; noise: (c,) variance by measurement; built: (c,) additional
    variance between copies not built exactly alike [m²].
    """

    d2: FloatArray
    noise: FloatArray
    built: FloatArray

    @classmethod
    def of(cls, a: Prepared, b: Prepared, corridors: IntArray, variation: float) -> _Lengths:
        i, j = corridors[:, 0], corridors[:, 1]
        longer = np.maximum(a.length[i], b.length[j])
        return cls(
            d2=(a.length[i] - b.length[j]) ** 2,
            noise=a.variance[i] + b.variance[j],
            built=2 * (variation * longer) ** 2,
        )

    def odds(self, d2: FloatArray, share: float) -> FloatArray:
        """Log likelihood ratio [nats] of the same place against a copy with `share` of its
        corridors exactly alike."""
        variance = self.noise + self.built
        log_ratio = 0.5 * np.log(self.noise / variance)  # of the varied density over the exact one
        log_ratio = log_ratio - np.minimum(d2 * (0.5 / variance), WORST_NATS)
        log_ratio += np.minimum(d2 * (0.5 / self.noise), WORST_NATS)
        return np.asarray(-np.log(share + (1 - share) * np.exp(log_ratio)))

    def averaged(self, share: float) -> float:
        """Log likelihood [nats] of the differences between copies."""
        exact = np.exp(_normal(self.d2, self.noise))
        varied = np.exp(_normal(self.d2, self.noise + self.built))
        return float(np.log(share * exact + (1 - share) * varied).sum())

    def tilted(self, share: float) -> FloatArray:
        """(exact share, tilt, corridor) log E[exp(tilt · odds)] over copies, for all exact shares
        and tilts; by Gaussian quadrature over differences."""
        moments = []
        for variance in (self.noise, self.noise + self.built):
            odds = self.odds(NODES[:, None] ** 2 * variance, share)  # by node
            powers = [np.einsum("n,nk", NODE_WEIGHTS, np.exp(tilt * odds)) for tilt in TILTS]
            moments.append(np.stack(powers))
        exact = SHARES[:, None, None]
        return np.asarray(np.log(exact * moments[0] + (1 - exact) * moments[1]))


def _normal(d2: FloatArray, variance: FloatArray) -> FloatArray:
    """Log of the normal density up to a constant, bounded from below."""
    return np.asarray(-0.5 * np.log(variance) - np.minimum(0.5 * d2 / variance, WORST_NATS))


def copy_model(
    samples: Sequence[tuple[Prepared, Candidate]], settings: RobustSettings
) -> CopyModel:
    """The copy model, updated by matches of maps with other parts of themselves (`samples`).

    If a building repeats itself to the centimetre within one map, it will do so across maps: equal
    lengths are then no evidence, and only changes can distinguish a place from its copy.
    """
    prior = default_copies(settings)
    log_odds = np.log(prior.exact_odds)
    changed, compared = 1.0, 1 / settings.copy_change_rate  # as if one change had been seen
    results = sameness([(m, m, c) for m, c in samples], prior)
    for (m, c), result in zip(samples, results, strict=True):
        lengths = _Lengths.of(m, m, c.corridors, prior.variation)
        # Half, because every pair of copies is found twice.
        log_odds = log_odds + np.array([lengths.averaged(share) for share in SHARES]) / 2
        changed += max(result.changed - 2 * _mean_fault_rate(m) * result.compared, 0.0)
        compared += result.compared
    exact_odds = np.exp(log_odds - np.logaddexp.reduce(log_odds)).tolist()
    change_rate = min(changed / compared, COPIES.most_changed)
    return CopyModel(prior.variation, tuple(exact_odds), change_rate)
