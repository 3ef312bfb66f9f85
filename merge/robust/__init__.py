"""Trusted merging: evidence in bits, three verdicts, no false merges."""

from .alignment import Candidate, match
from .decide import decide
from .prepare import Prepared, prepare
from .settings import DEFAULT_ROBUST, RobustSettings

__all__ = [
    "DEFAULT_ROBUST",
    "Candidate",
    "Prepared",
    "RobustSettings",
    "decide",
    "match",
    "prepare",
]
