"""Clustering of angles, on many circles at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .se2 import wrap


@dataclass(frozen=True, slots=True, eq=False)
class AngleClusters:
    """Clusters of angles, sorted by (owner, mean angle).

    of: (k,) cluster of each given angle; owner: (c,) circle of each cluster, from 0 on; mean: (c,)
    [rad] in [-pi, pi).
    """

    of: IntArray
    owner: IntArray
    mean: FloatArray

    def __len__(self) -> int:
        return len(self.owner)

    def votes(self, by: IntArray, which: BoolArray | None = None) -> IntArray:
        """(c,) number of different voters with an angle in each cluster.

        by: (k,) voter who gave each angle; which: (k,) angles that count, all by default.
        """
        given = np.stack([self.of, by])
        if which is not None:
            given = given[:, which]
        return np.bincount(np.unique(given, axis=1)[0], minlength=len(self))

    def well_seen(self, share: FloatArray, least: float) -> BoolArray:
        """(c,) whether a cluster has at least the share `least`, or the largest share of its
        circle; share: (c,)."""
        out = share >= least
        first = np.flatnonzero(np.diff(self.owner, prepend=-1))
        out[np.lexsort((-share, self.owner))[first]] = True
        return out


def cluster_angles(angle_rad: FloatArray, owner: IntArray, gap_rad: float) -> AngleClusters:
    """Single-linkage clusters of the angles (k,) [rad] of each circle (`owner`, (k,)), cut at gaps
    wider than `gap_rad`.

    All circles at once: sort by (owner, angle), open every circle at its widest gap, so that no
    cluster straddles the seam, and cut the sorted row. O(k log k).
    """
    if len(angle_rad) == 0:
        none = np.zeros(0, np.int64)
        return AngleClusters(none, none, np.zeros(0))
    circle = np.unique(owner, return_inverse=True)[1]
    angle = np.asarray(wrap(angle_rad))
    order = np.lexsort((angle, circle))
    a, c = angle[order], circle[order]
    start = np.concatenate([[0], np.cumsum(np.bincount(c))])
    following = np.arange(1, len(a) + 1)
    following[start[1:] - 1] = start[:-1]
    gap = (a[following] - a) % (2 * np.pi)
    widest = np.lexsort((-gap, c))[start[:-1]]
    seam = a[following[widest]]
    opened = (angle - seam[circle]) % (2 * np.pi)
    order = np.lexsort((opened, circle))
    row, c = opened[order], circle[order]
    new = np.diff(row, prepend=0.0) > gap_rad
    new[start[:-1]] = True
    cluster = np.cumsum(new) - 1
    home = c[np.flatnonzero(new)]
    mean = np.asarray(wrap(np.bincount(cluster, row) / np.bincount(cluster) + seam[home]))
    final = np.lexsort((mean, home))
    rank = np.empty_like(final)
    rank[final] = np.arange(len(final))
    of = np.empty(len(angle), np.int64)
    of[order] = rank[cluster]
    return AngleClusters(of, owner[order[new]][final], mean[final])
