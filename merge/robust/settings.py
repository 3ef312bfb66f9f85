"""Settings of trusted merging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True, slots=True)
class RobustSettings:
    """What may be tuned; the defaults are meant for every building.

    Everything that depends on how well a run was measured comes from its map's `RunNoise`.
    """

    false_merge_rate: float = 1e-3
    """Chance that a whole batch holds any false merge, at most."""
    min_matches: int = 5
    """Fewer matched junctions than this are never merged."""
    lead_bits: float = 4.0
    """What the best alignment must lead the next best one by."""
    hypotheses: int = 3
    """Candidate alignments grown per pair."""
    growth_rounds: int = 6
    """Rounds of predict, match, refit, at most."""
    gate_m: float = 0.55
    """Growth: a predicted junction is found within this distance …"""
    gate_per_m: float = 0.06
    """… plus this much per metre to the matches that predict it."""
    copy_variation: float = 0.02
    """Relative 1 sigma by which lengths differ between two copies of one design."""
    copy_change_rate: float = 0.09
    """Share of junctions that differ between two copies, faults of the runs aside."""

    def __post_init__(self) -> None:
        if not 0 < self.false_merge_rate < 1:
            raise ValueError(f"false_merge_rate must lie between 0 and 1: {self.false_merge_rate}")
        if self.min_matches < 2 or self.hypotheses < 2 or self.growth_rounds < 1:
            raise ValueError("min_matches and hypotheses must be 2 or more, growth_rounds positive")


DEFAULT_ROBUST = RobustSettings()


def settings_from_document(values: Mapping[str, Any]) -> RobustSettings:
    """The settings that a merged document names; those that it does not have their defaults.
    Raises ValueError on values that cannot be."""
    known: dict[str, Any] = {}
    for field in fields(RobustSettings):
        value = values.get(field.name, field.default)
        whole = isinstance(field.default, int)
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            number = "a whole number" if whole else "a number"
            raise ValueError(f"{field.name} must be {number}: {value!r}")
        known[field.name] = value
    return RobustSettings(**known)
