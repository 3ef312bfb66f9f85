"""Random walks seen through means: what a mean over several messages differs from another by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IntArray
from .ragged import numbered


@dataclass(frozen=True, slots=True, eq=False)
class WalkMeans:
    """Means of random walks over groups of messages, one group after the other.

    middle: (g, k) how far each of k walks had come at the middle of each group, in the unit that
    its variance grows with (metres driven, radians turned); NaN for groups without a message.
    lost: (g, k) by how much less the mean over a group varies than the walk at its middle.
    """

    middle: FloatArray
    lost: FloatArray

    @classmethod
    def of(cls, walked: FloatArray, group: IntArray, count: int) -> WalkMeans:
        """Of messages sorted by group and time: walked (m, k), ascending; group (m,) < count.

        A walk W of variance c at c has cov(W(c), W(d)) = min(c, d): the mean over a group varies by
        the mean of the lesser of two of its c, which is their mean less half of their mean
        difference.
        """
        size = np.bincount(group, minlength=count)
        n = np.where(size > 0, size, np.nan)[:, None]

        def total(values: FloatArray) -> FloatArray:
            return np.stack([np.bincount(group, v, count) for v in values.T], axis=1)

        middle = total(walked) / n
        _, rank = numbered(size)
        lead = (2 * rank + 1 - size[group])[:, None]
        return cls(middle, total(lead * (walked - middle[group])) / n**2)

    def between(self, first: IntArray, second: IntArray) -> FloatArray:
        """(m, k) variances, of walks of unit variance, of how much the mean over each group
        `second` differs from that over a group `first` before it."""
        out: FloatArray = (self.middle - self.lost)[second] - (self.middle + self.lost)[first]
        return out
