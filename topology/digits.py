"""How many digits a number in a document means.

Sums come out differently in their last digits on different processors. Documents say what was
found and no more, so that they are the same everywhere, and so are all that is made from them.

* Positions, lengths, paths: millimetres. No centre of a junction is known to better than 3 cm.
* Branches: 0.1 mrad, a hundredth of what one pass tells of a branch.
* Transforms: also microradians, which turn a point a kilometre away by a millimetre.
* Evidence: 0.01 bit, odds to 1 %.
* Sigmas, rates and the calibration: four digits, more than 10⁷ readings could tell of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

METRES = 3
BRANCH = 4
TURN = 6
BITS = 2
SIGNIFICANT = 4
"""Decimals; of sigmas, rates and the calibration all digits. Why so many: above."""

LARGEST_PLAIN = 1e9
"""Larger numbers, or none at all, are left to numpy."""


def rounded(values: Any, decimals: int = TURN) -> Any:
    """Numbers as they stand in documents: rounded, and never the two zeros 0.0 and -0.0."""
    if isinstance(values, float) and abs(values) < LARGEST_PLAIN:  # as numpy does, without it
        return round(values * 10.0**decimals) / 10.0**decimals + 0.0
    array = np.round(np.asarray(values, np.float64), decimals) + 0.0
    return array.tolist()


def significant(value: float) -> float:
    """A number to the digits that an estimate of an uncertainty has."""
    return float(f"{value:.{SIGNIFICANT - 1}e}") + 0.0
