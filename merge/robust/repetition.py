"""The test for copies: is this the place, or another copy of the same design?

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
from ...topology.quadratic_forms import MEDIAN_CHI2
from .atlas import Atlas
from .branches import lonely_branches
from .prepare import Prepared
from .settings import MATCH, RobustSettings

if TYPE_CHECKING:
    from .alignment import Candidate


@dataclass(frozen=True, slots=True)
class CopySettings:
    """Assumptions on copies, beside `copy_variation` and `copy_change_rate`."""

    exact_prior: tuple[float, ...] = (0.15, 0.25, 0.26, 0.22, 0.119, 0.001)
    """Prior odds, from none to all in equal steps, of the share of corridors that two copies have
    built exactly alike, before any map has shown how exactly it repeats itself: two fifths on
    average. Conservative: with it offices keep the promised rate (`benchmarks/calibration.py`)."""
    most_changed: float = 0.5
    """Upper bound of the share of junctions that differ between copies, whatever the maps' matches
    with themselves show: many of these are chance, not copies (`benchmarks/calibration.py`). Also
    of the detectors' fault rate, beyond which changes would carry no information."""
    most_stated: float = 0.3
    """Fault rates beyond are those of saved maps, of which doors and furniture of other times are
    part: upper bounds, against which two maps of one plan differ so little that they could be no
    copies. They are bounded by what the alignment shows. Without it maps of offices of one plan,
    drawn without noise, are merged (`benchmarks/grids.py`)."""


COPIES = CopySettings()

ROUNDING_NATS = np.sqrt(np.finfo(float).eps)
"""The bound is never negative; for a typical copy it is 0 up to this rounding error."""

WORST_NATS = LIKELIHOOD.most
"""Bound on the evidence of a single corridor: it may have been measured past a junction."""

TOGETHER = 2**6
"""Alignments per batch, to fit the processor's cache."""

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
    """bits: -log2 of an upper bound of the probability that a copy looks this much the same,
    negative where a typical copy looks more so; compared: junctions compared; changed: how many of
    them differ."""

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


def sameness_of(
    cases: Sequence[tuple[Prepared, Prepared, Candidate]], copies: CopyModel
) -> Iterator[Sameness]:
    """Evidence that alignments are the place itself and not a copy, from lengths and changes.

    Lengths: differences of common corridors. Changes: junctions that differ in their branches, or
    that only one map has, occur at the runs' fault rates in one place, more often between copies.
    The statistic T is the log likelihood ratio of the two, a sum over corridors and junctions. The
    result is a Chernoff bound of the probability that a copy reaches it: the minimum over x of
    E[exp(x (T' - T))] with T' the statistic of a copy (x = 1 gives the likelihood ratio itself, so
    that the bound is never worse).
    """
    for start in range(0, len(cases), TOGETHER):
        yield from _sameness_of(cases[start : start + TOGETHER], copies)


def _sameness_of(
    cases: Sequence[tuple[Prepared, Prepared, Candidate]], copies: CopyModel
) -> Iterator[Sameness]:
    matched = np.array([len(c) for _, _, c in cases])
    differing, usual = _differing(cases, np.cumsum([0, *matched]))
    against = np.array([len(c.conflicts) for _, _, c in cases])
    changed, compared = differing + against, matched + against
    stated = np.minimum(usual, COPIES.most_changed)
    seen = np.minimum(stated, (changed + 1) / (compared + 1))
    fault = np.where(stated > COPIES.most_stated, seen, stated)
    change = fault + (1 - fault) * copies.change_rate
    kept_nats, changed_nats = np.log((1 - fault) / (1 - change)), np.log(fault / change)
    parts = [_Lengths.of(a, b, c.corridors, copies.variation) for a, b, c in cases]
    shape, ends = joined(parts), np.cumsum([0, *(len(part.d2) for part in parts)])
    share = float(np.dot(copies.exact_odds, SHARES))
    nats = _sums(shape.odds(shape.d2, share), ends)
    nats += (compared - changed) * kept_nats + changed * changed_nats
    tilts = TILTS[:, None]
    spread = compared * np.log(
        (1 - change) * np.exp(tilts * kept_nats) + change * np.exp(tilts * changed_nats)
    )
    tilted = tilts * nats - spread - _sums(shape.tilted(share), ends)  # (share, tilt, case)
    weight = np.log(copies.exact_odds)[:, None]
    bound = -np.logaddexp.reduce(weight - tilted.max(axis=1), axis=0)
    # Below the value of a typical copy the statistic itself is used, for ranking.
    bits = np.where(bound <= ROUNDING_NATS, np.minimum(nats, 0.0), bound) / BIT
    return map(Sameness, bits.tolist(), compared.tolist(), changed.tolist())


def _differing(
    cases: Sequence[tuple[Prepared, Prepared, Candidate]], ends: IntArray
) -> tuple[IntArray, FloatArray]:
    """For each alignment the number of matched junctions that differ in their branches, and the
    share expected from the detectors' faults and confidences: of these junctions, or of both maps'
    where walls alone are matched."""
    number: dict[int, int] = {}
    rows = np.array([[number.setdefault(id(m), len(number)) for m in (a, b)] for a, b, _ in cases])
    maps = {id(m): m for a, b, _ in cases for m in (a, b)}
    atlas = Atlas.of([maps[key] for key in number])
    first = atlas.vertex[rows.repeat(np.diff(ends), axis=0)]
    va = np.concatenate([c.a for _, _, c in cases]) + first[:, 0]
    vb = np.concatenate([c.b for _, _, c in cases]) + first[:, 1]
    turn = np.concatenate([c.turn for _, _, c in cases])
    differs = np.where(lonely_branches(atlas.whole, atlas.whole, va, vb, turn) > 0, 1.0, 0.0)
    fault = atlas.whole.fault_rate[va] + atlas.whole.fault_rate[vb]
    fault += 1 - atlas.whole.confidence[va] * atlas.whole.confidence[vb]
    anywhere = [0.0 if len(c) else _usual_fault(a) + _usual_fault(b) for a, b, c in cases]
    usual = _sums(fault, ends) / np.maximum(np.diff(ends), 1) + anywhere
    return _sums(differs, ends).astype(np.int64), usual


def _usual_fault(m: Prepared) -> float:
    """The share of a map's junctions that faults of its detector and confidences leave open."""
    return float(np.mean(m.fault_rate + 1 - m.confidence))


def size_sigmas(a: Prepared, b: Prepared, corridors: IntArray) -> float:
    """By how many standard deviations one map is larger than the other over all corridors.

    A copy of another size is larger throughout, which single corridors do not show because each may
    be off by its odometry's scale. corridors: (c, 2) matched directed rows.
    """
    mean, variance = size_difference(a, b, corridors)
    return abs(mean) / float(np.sqrt(a.noise.scale**2 + b.noise.scale**2 + variance))


def fits_by_noise(a: Prepared, b: Prepared, corridors: IntArray) -> float:
    """Probability that two looks at one place differ by as much in their lengths (χ²).

    corridors: (c, 2) matched directed rows. None of them is far off, or it would not agree. Noise
    is at least what the median of them shows: where a map is bent more than it states all corridors
    are off, but copies are alike in most.
    """
    from scipy.special import chdtrc

    lengths = _Lengths.of(a, b, corridors, 0.0)
    squares = lengths.d2 / lengths.noise
    if len(squares) == 0:
        return 1.0
    usual = np.median(squares) / MEDIAN_CHI2
    return float(chdtrc(len(squares), squares.sum() / max(usual, 1.0)))


def size_difference(a: Prepared, b: Prepared, corridors: IntArray) -> tuple[float, float]:
    """Relative difference in size, a over b minus 1, and its variance without the odometries' scale
    errors; 0 and inf if no corridor can be compared."""
    i, j = corridors[:, 0], corridors[:, 1]
    one, two = a.length[i], b.length[j]
    off, variance = one - two, a.variance[i] + b.variance[j]
    fits = np.abs(off) < MATCH.length_sigmas * np.sqrt(variance)
    variance = variance - (a.noise.scale * one) ** 2 - (b.noise.scale * two) ** 2
    long = (one + two) / 2
    weight = np.where(fits, long**2 / variance, 0.0)
    total = float(weight.sum())
    if total == 0.0:
        return 0.0, np.inf
    return float((weight * off / long).sum()) / total, 1 / total


def _sums(values: FloatArray, ends: IntArray) -> FloatArray:
    """Sums over the last axis between consecutive `ends`; 0 for empty ranges."""
    some = np.flatnonzero(np.diff(ends))
    out = np.zeros((*values.shape[:-1], len(ends) - 1))
    if len(some):
        out[..., some] = np.add.reduceat(values, ends[some], axis=-1)
    return out


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
        whole = self.noise + self.built
        ahead = 0.5 * np.log(self.noise / whole)  # of the varied density over the exact one
        ahead = ahead - np.minimum(d2 * (0.5 / whole), WORST_NATS)
        ahead += np.minimum(d2 * (0.5 / self.noise), WORST_NATS)
        return np.asarray(-np.log(share + (1 - share) * np.exp(ahead)))

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
    """The copy model, updated by maps that match other parts of themselves.

    If a building repeats itself to the centimetre within one map, it will do so across maps: equal
    lengths are then no evidence, and only changes can distinguish a place from its copy.
    """
    prior = default_copies(settings)
    odds = np.log(prior.exact_odds)
    changed, places = 1.0, 1 / settings.copy_change_rate  # as if one change had been seen
    told = sameness_of([(m, m, c) for m, c in samples], prior)
    for (m, c), same in zip(samples, told, strict=True):
        shape = _Lengths.of(m, m, c.corridors, prior.variation)
        # Half, because every pair of copies is found twice.
        odds = odds + np.array([shape.averaged(share) for share in SHARES]) / 2
        changed += max(same.changed - 2 * _usual_fault(m) * same.compared, 0.0)
        places += same.compared
    odds = np.exp(odds - np.logaddexp.reduce(odds))
    return CopyModel(
        prior.variation, tuple(odds.tolist()), min(changed / places, COPIES.most_changed)
    )
