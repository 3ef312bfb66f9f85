"""Variances of differences between means of a random walk over groups of messages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IntArray
from .ragged import numbered


@dataclass(frozen=True, slots=True, eq=False)
class WalkMeans:
    """Means of random walks over groups of messages, one group after the other.

    middle: (g, k) mean argument of each of k walks in each group, in the unit that the walk's
    variance grows with (metres driven, radians turned); NaN for groups without a message. lost: (g,
    k) variance of the walk at the middle, minus that of the group's mean.
    """

    middle: FloatArray
    lost: FloatArray

    @classmethod
    def of(cls, walked: FloatArray, group: IntArray, count: int) -> WalkMeans:
        """From messages sorted by group and time: walked (m, k), ascending; group (m,) < count.

        A walk W with variance c at c has cov(W(c), W(d)) = min(c, d): the variance of the mean over
        a group is the mean of min(c, d) over its pairs, i.e. their mean minus half of their mean
        absolute difference.
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
        """(m, k) variances, for walks of unit variance, of the difference between the means over
        groups `second` and over earlier groups `first` (m,)."""
        return np.asarray((self.middle - self.lost)[second] - (self.middle + self.lost)[first])
