"""Polylines: (k, 2) points in a row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def simplify(path: FloatArray, tolerance: float) -> FloatArray:
    """Fewer points, none of the old ones farther than `tolerance` from the new line.

    Douglas and Peucker's rule; both ends stay, even when they coincide. O(k · points kept).
    """
    keep = np.zeros(len(path), bool)
    keep[[0, -1]] = True
    spans = [(0, len(path) - 1)]
    while spans:
        a, b = spans.pop()
        if b - a < 2:
            continue
        chord, d = path[b] - path[a], path[a + 1 : b] - path[a]
        length2 = float(chord @ chord)
        along = np.clip(d @ chord / length2, 0.0, 1.0) if length2 > 0 else np.zeros(len(d))
        off = np.hypot(*(d - along[:, None] * chord).T)
        worst = int(off.argmax())
        if off[worst] > tolerance:
            middle = a + 1 + worst
            keep[middle] = True
            spans += [(a, middle), (middle, b)]
    return path[keep]
