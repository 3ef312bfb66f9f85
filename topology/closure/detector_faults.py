"""Error rates of a run's detector, counted at the places identified so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..topomap import RunNoise
from .places import Places


@dataclass(frozen=True, slots=True)
class RateSettings:
    """Prior of a detector's error rates."""

    prior_passes: float = 25.0
    """Weight of the prior rates, in passes."""


def measured_rates(
    places: Places, noise: RunNoise, settings: RateSettings = RateSettings()
) -> RunNoise:
    """The noise, with the detector's error rates estimated on this run.

    miss_rate: of traversals of a corridor that mostly leads to one place, the share that ended at
    another one because of a missed or a spurious detection. branch_fault_rate: of observations of a
    branch at places with three passes or more, the share that disagrees with the majority.
    """
    several = places.tried >= 2
    torn = float((places.tried - places.driven)[several].sum())
    legs = float((places.tried - 1)[several].sum())
    known = places.visits >= 3
    share = places.share[known]
    odd = np.where(np.isfinite(places.heading[known]), np.minimum(share, 1 - share), 0.0)
    faults = float((odd.sum(axis=1) * places.visits[known]).sum())
    passes = float(places.visits[known].sum())

    def rate(prior: float, count: float, of: float) -> float:
        worth = settings.prior_passes
        return (prior * worth + count) / (worth + of)

    return replace(
        noise,
        miss_rate=rate(noise.miss_rate, torn, legs),
        branch_fault_rate=rate(noise.branch_fault_rate, faults, passes),
    )
