"""Robust merging: evidence in bits, three verdicts, a bounded rate of false merges."""

from .alignment import Candidate, match
from .batch import match_shard
from .decide import decide
from .pairing import Means, era_of
from .prepare import Prepared, prepare
from .settings import DEFAULT_ROBUST, RobustSettings

__all__ = [
    "DEFAULT_ROBUST",
    "Candidate",
    "Means",
    "Prepared",
    "RobustSettings",
    "decide",
    "era_of",
    "match",
    "match_shard",
    "prepare",
]
