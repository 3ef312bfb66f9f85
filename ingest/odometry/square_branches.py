"""Branches perpendicular or parallel to those of earlier passes, as evidence on heading drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.odometry import Odometry
from ...topology.passes import Passes
from ...topology.ragged import numbered
from ...topology.se2 import wrap
from ...topology.track import stretch_of
from ...topology.walk_means import WalkMeans


@dataclass(frozen=True, slots=True, eq=False)
class SquareBranches:
    """Pairs of branches of different passes.

    residual: (k,) angle between them, to the nearest multiple of 90° [rad]; walked: (k, 2) distance
    [m] and angle turned [rad] between both; worth: (k,) weight of each pair, in independent
    observations.
    """

    residual: FloatArray
    walked: FloatArray
    worth: FloatArray

    @classmethod
    def of(
        cls,
        odometry: Odometry,
        passes: Passes,
        means: WalkMeans,
        *,
        reach_passes: int,
        reach_m: float,
        most_passes: int,
    ) -> SquareBranches:
        """Branches of `most_passes` passes paired with those of `reach_passes` passes before each,
        at most `reach_m` back. means: over the messages of each pass."""
        stretch, of = stretch_of(odometry, passes.time_ns), passes.branches.owner
        stride = -(-len(passes) // most_passes)
        b = np.flatnonzero(of % stride == 0)
        # Every branch against every one of `reach_passes` earlier passes: (branch, lag), then
        # expand each by the branches of that pass.
        lag = np.tile(np.arange(reach_passes) + 1, len(b))
        b = np.repeat(b, reach_passes)
        earlier = of[b] - lag
        keep = earlier >= 0
        b, earlier = b[keep], earlier[keep]
        walked = means.between(earlier, of[b])
        keep = (stretch[of[b]] == stretch[earlier]) & (walked[:, 0] <= reach_m)
        b, earlier, walked = b[keep], earlier[keep], walked[keep]
        counts = passes.branches.counts[earlier]
        pair, local = numbered(counts)
        there = passes.branches.offsets[earlier][pair] + local
        turn = passes.branches.values[b][pair] - passes.branches.values[there]
        return cls(
            np.asarray(wrap(4 * turn) / 4),
            walked[pair],
            # Branches of one pass share the error of the heading, and the lags share the way:
            # together they are one look.
            1.0 / (passes.branches.counts[of[b]] * counts * reach_passes)[pair],
        )

    def cost(self, walk: FloatArray, sigma: float, square: float) -> float:
        """Negative log-likelihood relative to a uniform distribution.

        walk: (2,) variances of the heading [rad²] per metre and per radian; sigma: of one branch
        [rad]; square: share of the pairs that are perpendicular or parallel. Each pair counts by
        itself: taking only the best of several candidates would underestimate the drift.
        """
        quarter = np.pi / 2
        variance = 2 * sigma**2 + self.walked @ walk
        # Two images of the wrapped normal are enough up to a sigma of 45°.
        density = sum(
            np.exp(-0.5 * (self.residual + shift) ** 2 / variance)
            for shift in (-quarter, 0, quarter)
        ) / np.sqrt(2 * np.pi * variance)
        return -float((self.worth * np.log((1 - square) + square * quarter * density)).sum())
