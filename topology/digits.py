"""Rounding of numbers in documents.

The last digits of floating point sums depend on the processor. Documents hold only the digits that
carry meaning, so that they, and all that is derived from them, are the same everywhere.

* Positions, lengths, paths: millimetres. No centre of a junction is known to better than 3 cm.
* Branches: 0.1 mrad, a hundredth of the error of one pass.
* Transforms: also microradians, which move a point a kilometre away by a millimetre.
* Evidence: 0.01 bit, odds to 1 %.
* Shares by which all lengths are wrong: 10⁻⁵, a millimetre in 100 m.
* Sigmas, rates and the calibration: four significant digits, more than 10⁷ readings could support.
"""

from __future__ import annotations

from typing import Any

import numpy as np

METRES = 3
BRANCH = 4
TURN = 6
BITS = 2
LENGTH_SCALE = 5
SIGNIFICANT = 4
"""Decimals; for sigmas, rates and the calibration significant digits. Reasons: see above."""


def rounded(values: Any, decimals: int = TURN) -> Any:
    """Numbers as they stand in documents: rounded, with -0.0 as 0.0."""
    if isinstance(values, float):
        return round(values, decimals) + 0.0
    array = np.round(np.asarray(values, np.float64), decimals) + 0.0
    return array.tolist()


def significant(value: float) -> float:
    """A number rounded to `SIGNIFICANT` digits, for estimated uncertainties."""
    return float(f"{value:.{SIGNIFICANT - 1}e}") + 0.0
