"""Evidence that two places are one, in natural log odds: position and lengths of corridors.

Every term compares "the same place" with "another place of this run", so that what is common in a
run is worth little. Lengths are judged as everywhere (`matching/likelihood.py`); branches have a
module of their own (`branches.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chndtr

from ..arrays import FloatArray
from ..matching.likelihood import LIKELIHOOD, Lengths, length_log_density
from ..topomap import RunNoise
from .dead_reckoning import DeadReckoning
from .lattice import Lattice, LatticeSettings, lattice_of, no_lattice, squared_mahalanobis
from .negative_information import DrivenGround
from .places import Places


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """Rates and widths that the noise of a run does not tell."""

    core_quantile: float = 0.03
    """Two junctions are seldom (`LIKELIHOOD.fault_floor`) nearer to each other than the corridors
    at this quantile of all are long (tried: 0.1, the same), and seldom farther from the track, but
    for this share of passes, when they are reported."""
    inflation: float = 1.2
    """Widths of the noise are taken this much larger than estimated: of few repeats. Tried: with 1,
    two places of a run on tiles are taken for one."""
    bandwidth_rad: float = 0.12
    """Width of the kernels that say how common a set of branches is in this run, beside the noise.
    Tried: with 0 and 0.06 a place of a real run (Intel) is no longer found again."""
    references: int = 100
    """Places that stand for the run when asking how common a set of branches is."""
    strip: int = 64
    """Places whose aliasing_penalty is worked out at once: what the processor keeps at hand."""
    lead: float = 3.0
    """Log odds that tell two answers apart, 20 to one: of sets of identifications over those that
    exclude one of them and of each candidate that joins a set (`joint_compatibility.py`), and of
    likeness over what is nearly as much alike (`candidates.py`)."""
    pattern: LatticeSettings = field(default_factory=LatticeSettings)


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """What is usual in a run, against which likeness is judged.

    leg_m: median way from one pass to the next [m]. core_m: radius [m] within which no other
    junction is expected. reach_m: how far beside the track junctions are reported. lengths:
    distribution of these ways. branch_sigma, centre_sigma: 1 sigma of one detection [rad, m].
    fault_rate, miss_rate: of branches and of junctions. lattice: where other junctions lie relative
    to a junction.
    """

    leg_m: float
    core_m: float
    reach_m: float
    lengths: Lengths
    branch_sigma: float
    centre_sigma: float
    fault_rate: float
    miss_rate: float
    lattice: Lattice = field(default_factory=no_lattice)

    @property
    def density(self) -> float:
        """Places per m²: each is the middle of a cell about as wide as a typical leg."""
        return 1.0 / self.leg_m**2


def background(
    reckoning: DeadReckoning, noise: RunNoise, settings: EvidenceSettings = EvidenceSettings()
) -> Background:
    """Statistics of a run that evidence is measured against. noise: as far as the run has shown
    it."""
    legs = reckoning.leg[np.isfinite(reckoning.leg)]
    # Chords: a leg that turns back or winds says nothing about how close junctions lie.
    chord = np.hypot(*np.diff(reckoning.passes.centre, axis=0).T)
    chord = chord[np.isfinite(reckoning.leg)]
    # A robot that stands has legs, too: of no length but for the noise of the two centres.
    centre_sigma = settings.inflation * noise.centre_m
    moved = chord[chord > LIKELIHOOD.gate_sigmas * np.sqrt(2) * centre_sigma]
    core_m = float(np.quantile(moved, settings.core_quantile)) if len(moved) else 1.0
    typical = float(np.median(legs)) if len(legs) else core_m
    return Background(
        leg_m=max(typical, core_m),
        core_m=core_m,
        reach_m=float(np.quantile(reckoning.aside, 1.0 - settings.core_quantile)),
        lengths=Lengths.of(legs),
        branch_sigma=settings.inflation * noise.branch_rad,
        centre_sigma=centre_sigma,
        fault_rate=max(noise.branch_fault_rate, LIKELIHOOD.fault_floor),
        miss_rate=max(noise.miss_rate, LIKELIHOOD.fault_floor),
    )


def with_lattice(
    common: Background, places: Places, xy: FloatArray, settings: EvidenceSettings
) -> Background:
    """The background with the arrangement of neighbouring junctions in a map of places at `xy` (n,
    2)."""
    found = lattice_of(
        places, xy, core_m=common.core_m, typical_m=common.leg_m, settings=settings.pattern
    )
    return replace(common, lattice=found)


def position_odds(
    common: Background, shift: FloatArray, cov: FloatArray, ground: DrivenGround | None = None
) -> tuple[FloatArray, FloatArray]:
    """(k,) log odds that two places are one by position alone, and their squared Mahalanobis
    distance.

    shift: (k, 2) [m] between the two, with covariance `cov` (k, 2, 2) [m²]. The alternative is
    another junction, which may lie anywhere outside of the core around this one, but on ground that
    was driven without a report only if it was missed.
    """
    x, y = shift.T
    d2, det = squared_mahalanobis(x, y, cov)
    s2 = np.sqrt(det)
    # So far off that none of it is inside, it need not be told how far.
    far = (common.core_m / np.sqrt(s2) + 2 * LIKELIHOOD.gate_sigmas) ** 2
    inside = chndtr(common.core_m**2 / s2, 2.0, np.minimum((x * x + y * y) / s2, far))
    # Exceptions within the core are doors side by side, not one upon the other.
    apart = np.minimum((x * x + y * y + 2 * s2) / common.core_m**2, 1.0)
    outside = 1.0 - inside
    if ground is not None:
        driven = np.minimum(ground.share(shift, cov, common.core_m, common.reach_m), outside)
        outside = outside - (1.0 - common.miss_rate) * driven
    rival = common.density * np.maximum(outside, LIKELIHOOD.fault_floor * apart)
    odds = -0.5 * d2 - np.log(2 * np.pi * s2) - np.log(rival)
    return odds, d2


def among_neighbours(
    common: Background, odds: FloatArray, shift: FloatArray, cov: FloatArray
) -> FloatArray:
    """(k,) `odds` of `position_odds`, lowered where another junction of this map may well lie at
    `shift`: the alternative is then a neighbour in the lattice, too."""
    if not common.lattice.repeats:
        return odds
    # Neighbours are beyond the core: what is known much better than that cannot be one.
    room = common.core_m - np.hypot(*shift.T)
    vague = np.flatnonzero(room**2 < LIKELIHOOD.gate_sigmas**2 * (cov[:, 0, 0] + cov[:, 1, 1]))
    shift, cov = shift[vague], cov[vague]
    d2, det = squared_mahalanobis(shift[:, 0], shift[:, 1], cov)
    density = np.maximum(common.lattice.density(shift, cov), np.finfo(np.float64).tiny)
    out = odds.copy()
    against = -0.5 * d2 - np.log(2 * np.pi * np.sqrt(det)) - np.log(density)
    out[vague] = np.minimum(odds[vague], against)
    return out


def best_position_odds(common: Background, shift: FloatArray) -> FloatArray:
    """(k,) `position_odds` at the round covariance that suits each shift best.

    About the most that they can be, cheaply. No strict bound: a long, thin covariance along the
    shift, or one that places the other certainly within the core, can give a few nats more.
    """
    s2 = np.maximum(0.5 * (shift**2).sum(axis=1), 2 * common.centre_sigma**2)
    odds, _ = position_odds(common, shift, s2[:, None, None] * np.eye(2))
    return odds


def length_odds(common: Background, a: FloatArray, b: FloatArray, var: FloatArray) -> FloatArray:
    """(k,) log odds that two legs of lengths a and b are one corridor."""
    chance = np.minimum(common.lengths.rarity(a), common.lengths.rarity(b))
    return np.asarray(length_log_density(a - b, var) + chance)
