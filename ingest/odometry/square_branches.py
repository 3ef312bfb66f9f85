"""Branches square to those of earlier passes, the less exactly the longer the way between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.passes import Passes
from ...topology.ragged import numbered
from ...topology.se2 import wrap
from ...topology.track import interpolated, stretch_of, way_at


@dataclass(frozen=True, slots=True, eq=False)
class SquareBranches:
    """Branches beside those of passes before: angle to the next multiple of 90°, way between."""

    residual: FloatArray
    way: FloatArray
    turned: FloatArray
    owner: IntArray
    share: FloatArray
    worth: FloatArray

    @classmethod
    def of(
        cls,
        odometry: Odometry,
        passes: Passes,
        *,
        reach_passes: int,
        reach_m: float,
        most_passes: int,
    ) -> SquareBranches:
        """Branches of `most_passes` passes beside those of `reach_passes` passes before each, as
        far back as `reach_m`."""
        way = way_at(odometry, passes.time_ns)
        turned = interpolated(odometry, np.cumsum(np.abs(odometry.turn_rad)), passes.time_ns)
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
        keep = (stretch[of[b]] == stretch[earlier]) & (way[of[b]] - way[earlier] <= reach_m)
        b, earlier = b[keep], earlier[keep]
        counts = passes.branches.counts[earlier]
        owner, local = numbered(counts)
        there = passes.branches.offsets[earlier][owner] + local
        turn = passes.branches.values[b][owner] - passes.branches.values[there]
        return cls(
            np.asarray(wrap(4 * turn) / 4),
            (way[of[b]] - way[earlier])[owner],
            (turned[of[b]] - turned[earlier])[owner],
            owner,
            1.0 / counts[owner],
            # Branches of one pass share the error of the heading, and the lags share the way:
            # together they are one look.
            1.0 / (passes.branches.counts[of[b]] * reach_passes),
        )

    def cost(self, walk_m: float, walk_rad: float, sigma: float, square: float) -> float:
        """Negative log-likelihood gain over "anything goes"; `square` is the share that is square.

        As in the calibration, a branch is square to one of those before it, or anything.
        """
        if len(self.residual) == 0:
            return 0.0
        quarter = np.pi / 2
        variance = 2 * sigma**2 + walk_m * self.way + walk_rad * self.turned
        # Two images of the wrapped normal are enough up to a sigma of 45°.
        density = sum(
            np.exp(-0.5 * (self.residual + shift) ** 2 / variance)
            for shift in (-quarter, 0, quarter)
        ) / np.sqrt(2 * np.pi * variance)
        inlier = np.bincount(self.owner, self.share * density, len(self.worth))
        return -float((self.worth * np.log((1 - square) + square * quarter * inlier)).sum())
