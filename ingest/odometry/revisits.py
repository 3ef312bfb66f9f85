"""Repeated passes by the same places, and their differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.circular import cluster_angles
from ...topology.passes import Passes
from ...topology.se2 import wrap


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Branches of places that were passed at least twice.

    Flat over sightings (pass, cluster): visit, cluster, off [rad] from the cluster's mean. Per
    cluster: place, sightings. passes: (places,) number of passes of each.
    """

    visit: IntArray
    cluster: IntArray
    off: FloatArray
    place: IntArray
    sightings: IntArray
    passes: IntArray

    @classmethod
    def of(
        cls, passes: Passes, vertex: IntArray, turn_rad: FloatArray, match_rad: float
    ) -> Repeats:
        """From the passes with a place (`vertex` >= 0) that was passed at least twice.

        turn_rad: (p,) rotation from the odometry frame to the map frame; branches nearer than
        `match_rad` are the same. O(b log b).
        """
        count = np.bincount(vertex[vertex >= 0], minlength=1)
        owner = passes.branches.owner
        home = vertex[owner]
        rows = np.flatnonzero((home >= 0) & (count[np.maximum(home, 0)] >= 2))
        heading = np.asarray(wrap(passes.branches.values[rows] + turn_rad[owner[rows]]))
        clusters = cluster_angles(heading, home[rows], match_rad)
        # A pass that has two branches in one cluster saw it once.
        pairs, first = np.unique(np.stack([clusters.of, owner[rows]]), axis=1, return_index=True)
        off = np.asarray(wrap(heading - clusters.mean[clusters.of]))[first]
        sightings = np.bincount(pairs[0], minlength=len(clusters))
        return cls(pairs[1], pairs[0], off, clusters.owner, sightings, count)

    def faults(self) -> tuple[float, int]:
        """Number of passes with a branch missing or invented, and number of passes considered.

        The majority of a place's passes is right; of two passes that differ, one is wrong.
        """
        k = self.passes[self.place]
        absent = k - self.sightings
        # Of each cluster, the smaller side is at fault; a tie makes half of both.
        wrong = np.minimum(self.sightings, absent).astype(np.float64)
        judged = self.passes[self.passes >= 2]
        by_place = np.bincount(self.place, wrong, len(self.passes))[self.passes >= 2]
        # One pass with several wrong branches is one fault; fewer than half can be at fault.
        return float(np.minimum(by_place, judged / 2).sum()), int(judged.sum())

    def branch_sigma(self, prior: float, worth: float) -> float:
        """1 sigma of a branch heading in one pass [rad]: residuals after fitting the direction of
        every branch and the rotation of every pass.

        Robust: from the median, scaled for the degrees of freedom of the two means. prior: 1 sigma,
        with the weight `worth`.
        """
        visit = np.unique(self.visit, return_inverse=True)[1]
        size = np.bincount(visit)
        off = self.off - (np.bincount(visit, self.off) / np.maximum(size, 1))[visit]
        k, c = self.sightings[self.cluster], size[visit]
        free = (k >= 2) & (c >= 2)
        if not free.any():
            return prior
        freedom = (1 - 1 / k[free]) * (1 - 1 / c[free])
        scaled = np.abs(off[free]) / np.sqrt(freedom)
        weight = float(freedom.sum())
        found = float(np.median(scaled)) / 0.6745
        return float(np.sqrt((weight * found**2 + worth * prior**2) / (weight + worth)))
