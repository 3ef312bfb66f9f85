"""Which errors are too large to be errors: one chance for every gate."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.special import chdtri


@dataclass(frozen=True, slots=True)
class GateSettings:
    """When two readings are not of one thing."""

    chance: float = 5e-4
    """What is rarer than this among readings of one thing is taken for two: a run of 2,000 passes
    loses one. 3.5 sigmas in one dimension."""

    def squared(self, freedom: int) -> float:
        """Largest squared error, in sigmas, of so many dimensions together: the quantile of χ²."""
        return float(chdtri(freedom, self.chance))


GATE = GateSettings()
