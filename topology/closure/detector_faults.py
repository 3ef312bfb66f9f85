"""How often the detector of a run errs, counted at the places known so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..topomap import RunNoise
from .places import Places


@dataclass(frozen=True, slots=True)
class RateSettings:
    """The prior of a detector's rates of faults."""

    prior_passes: float = 25.0
    """Worth of the prior rates, in passes."""


def measured_rates(
    places: Places, noise: RunNoise, settings: RateSettings = RateSettings()
) -> RunNoise:
    """The noise, with the detector's rates of faults measured on this run.

    miss_rate: of drives along a corridor that mostly leads to one place, those that came out at
    another one, having passed a junction unseen or reported one that is none. branch_fault_rate: of
    looks at a branch of a place with three passes or more, those that disagree with the majority.
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
