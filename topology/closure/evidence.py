"""Evidence [nats] that two places are one: position and lengths of corridors.

Every term compares "the same place" with "another place of this run", so that what is common in a
run contributes little. Lengths are compared by `matching/likelihood.py`, branches by `branches.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chndtr

from ..arrays import FloatArray
from ..matching.likelihood import LIKELIHOOD, Lengths, length_log_density
from ..topomap import RunNoise
from .dead_reckoning import DeadReckoning
from .lattice import NO_LATTICE, Lattice, squared_mahalanobis
from .negative_information import DrivenGround
from .places import Places


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """Parameters of the evidence that are not estimated from a run."""

    core_quantile: float = 0.03
    """Quantile of the lengths of all corridors that is the core: two junctions are seldom
    (`LIKELIHOOD.fault_floor`) nearer to each other. Tried: 0.1, no change. Also the share of passes
    that are farther from the track than `Background.reach_m`."""
    inflation: float = 1.2
    """Factor on the estimated sigmas, which are from few revisits. Tried: with 1, two places on
    tiles are identified."""
    bandwidth_rad: float = 0.12
    """Width of the kernels of the null model of sets of branches, in addition to the noise [rad].
    Tried: with 0 and 0.06 a revisit of a real run (Intel) is no longer found."""
    references: int = 100
    """Size of the sample of places for the null model of sets of branches, and of the batches of
    places that are compared with it."""
    lead: float = 3.0
    """Required lead over alternatives [nats], 20 to one: of sets of identifications over those that
    exclude one of them, and of each candidate that joins a set (`joint_compatibility.py`)."""


EVIDENCE = EvidenceSettings()


PRIOR_PASSES = 15.0
"""Weight of the prior of a detector's error rates, in passes."""


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """Statistics of a run, the null model for evidence.

    leg_m: median distance driven from one pass to the next [m]. core_m: radius [m] within which no
    other junction is expected. reach_m: distance from the track up to which junctions are reported
    [m]. lengths: distribution of the legs. branch_sigma, centre_sigma: 1 sigma of one detection
    [rad, m]. fault_rate, miss_rate: of branches and of junctions. lattice: positions of other
    junctions relative to a junction.
    """

    leg_m: float
    core_m: float
    reach_m: float
    lengths: Lengths
    branch_sigma: float
    centre_sigma: float
    fault_rate: float
    miss_rate: float
    lattice: Lattice = NO_LATTICE

    @property
    def density(self) -> float:
        """Places per m²: each is taken to be the centre of a cell as wide as a typical leg."""
        return 1.0 / self.leg_m**2


def measured_rates(places: Places, noise: RunNoise) -> RunNoise:
    """The noise, with the detector's error rates estimated from this run.

    miss_rate: share of the traversals of a corridor that ended at another place than most, because
    of a missed or a spurious detection. branch_fault_rate: share of the observations of a branch
    that disagree with the majority, at places with three passes or more.
    """
    repeated = places.tried >= 2
    failures = float((places.tried - places.driven)[repeated].sum())
    legs = float((places.tried - 1)[repeated].sum())
    visited = places.visits >= 3
    share = places.share[visited]
    disagreeing = np.where(np.isfinite(places.heading[visited]), np.minimum(share, 1 - share), 0.0)
    faults = float((disagreeing.sum(axis=1) * places.visits[visited]).sum())
    passes = float(places.visits[visited].sum())

    def rate(prior: float, count: float, of: float) -> float:
        return (prior * PRIOR_PASSES + count) / (PRIOR_PASSES + of)

    return replace(
        noise,
        miss_rate=rate(noise.miss_rate, failures, legs),
        branch_fault_rate=rate(noise.branch_fault_rate, faults, passes),
    )


def background(reckoning: DeadReckoning, noise: RunNoise) -> Background:
    """The statistics of a run. noise: with `measured_rates`."""
    legs = reckoning.leg[np.isfinite(reckoning.leg)]
    # Chords: the length of a leg that turns back or winds does not bound the junctions' distance.
    chord = np.hypot(*np.diff(reckoning.passes.centre, axis=0).T)
    chord = chord[np.isfinite(reckoning.leg)]
    # Legs of a standing robot have only the noise of the two centres as length.
    centre_sigma = EVIDENCE.inflation * noise.centre_m
    moved_chord = chord[chord > LIKELIHOOD.gate_sigmas * np.sqrt(2) * centre_sigma]
    core_m = float(np.quantile(moved_chord, EVIDENCE.core_quantile)) if len(moved_chord) else 1.0
    typical_m = float(np.median(legs)) if len(legs) else core_m
    return Background(
        leg_m=max(typical_m, core_m),
        core_m=core_m,
        reach_m=float(np.quantile(reckoning.aside, 1.0 - EVIDENCE.core_quantile)),
        lengths=Lengths.of(legs),
        branch_sigma=EVIDENCE.inflation * noise.branch_rad,
        centre_sigma=centre_sigma,
        fault_rate=max(noise.branch_fault_rate, LIKELIHOOD.fault_floor),
        miss_rate=max(noise.miss_rate, LIKELIHOOD.fault_floor),
    )


def position_odds(
    common: Background, shift: FloatArray, cov: FloatArray, ground: DrivenGround | None = None
) -> tuple[FloatArray, FloatArray]:
    """(k,) each: log odds [nats] that two places are one by position alone, and their squared
    Mahalanobis distance.

    shift: (k, 2) [m] between the two, with covariance `cov` (k, 2, 2) [m²]. The alternative is
    another junction anywhere outside the core around this one; on `ground` that was driven without
    a detection it must have been missed.
    """
    x, y = shift.T
    d2, det = squared_mahalanobis(x, y, cov)
    area = np.sqrt(det)
    # Bounded where the probability inside the core is 0 anyway.
    bounded_d2 = (common.core_m / np.sqrt(area) + 2 * LIKELIHOOD.gate_sigmas) ** 2
    inside = chndtr(common.core_m**2 / area, 2.0, np.minimum((x * x + y * y) / area, bounded_d2))
    # Two junctions within the core (doors side by side) do not coincide.
    apart = np.minimum((x * x + y * y + 2 * area) / common.core_m**2, 1.0)
    outside = 1.0 - inside
    if ground is not None:
        driven = np.minimum(ground.share(shift, cov, common.core_m, common.reach_m), outside)
        outside = outside - (1.0 - common.miss_rate) * driven
    rival = common.density * np.maximum(outside, LIKELIHOOD.fault_floor * apart)
    odds = -0.5 * d2 - np.log(2 * np.pi * area) - np.log(rival)
    return odds, d2


def among_neighbours(
    common: Background, odds: FloatArray, shift: FloatArray, cov: FloatArray
) -> FloatArray:
    """(k,) the `odds` of `position_odds`, lowered where the lattice predicts another junction at
    `shift`: it is an additional alternative."""
    if not common.lattice.repeats:
        return odds
    # Neighbours lie outside the core: only uncertain pairs can be confused with them.
    margin_m = common.core_m - np.hypot(*shift.T)
    uncertain = np.flatnonzero(
        margin_m**2 < LIKELIHOOD.gate_sigmas**2 * (cov[:, 0, 0] + cov[:, 1, 1])
    )
    shift, cov = shift[uncertain], cov[uncertain]
    d2, det = squared_mahalanobis(shift[:, 0], shift[:, 1], cov)
    density = np.maximum(common.lattice.density(shift, cov), np.finfo(np.float64).tiny)
    lowered = odds.copy()
    odds_against_neighbour = -0.5 * d2 - np.log(2 * np.pi * np.sqrt(det)) - np.log(density)
    lowered[uncertain] = np.minimum(odds[uncertain], odds_against_neighbour)
    return lowered


def length_odds(common: Background, a: FloatArray, b: FloatArray, var: FloatArray) -> FloatArray:
    """(k,) log odds [nats] that two legs of lengths a and b [m] are one corridor; var: of a - b
    [m²]."""
    chance = np.minimum(common.lengths.rarity(a), common.lengths.rarity(b))
    return np.asarray(length_log_density(a - b, var) + chance)
