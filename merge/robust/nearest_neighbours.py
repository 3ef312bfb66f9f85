"""Nearest neighbours in a fixed set of points, for many queries at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from .settings import MATCH


@dataclass(frozen=True, slots=True, eq=False)
class NearestNeighbours:
    """A search structure for points z (n,), x + iy: a matrix for exhaustive search and a tree."""

    z: ComplexArray
    centre: complex
    across: FloatArray
    half: FloatArray
    tree: cKDTree | None

    @classmethod
    def of(cls, z: ComplexArray) -> NearestNeighbours:
        """Build the structure. O(n log n)."""
        centre = complex(z.mean()) if len(z) else 0j
        points = _points(z - centre)
        half = (points * points).sum(axis=1) / 2
        tree = cKDTree(points) if len(z) else None
        return cls(z, centre, np.ascontiguousarray(points.T), half, tree)

    def __len__(self) -> int:
        return len(self.z)

    def nearest(self, where: ComplexArray, within_m: float) -> tuple[FloatArray, IntArray]:
        """(k,) each: distances of `where` (k,) to the nearest points, and their indices.

        For queries without a point within `within_m` the distance is only known to be larger, and
        the index may be out of range.
        """
        if self.tree is None:
            return np.full(len(where), np.inf), np.zeros(len(where), np.int64)
        moved = where - self.centre
        if len(where) * len(self.z) > MATCH.most_pairs:
            gap, index = self.tree.query(_points(moved), distance_upper_bound=within_m)
            return np.asarray(gap), np.asarray(index)
        # Nearest is where |w - z|² = |w|² - 2 (w · z - |z|² / 2) is least.
        score = _points(moved) @ self.across
        score -= self.half
        index = score.argmax(axis=1)
        return np.abs(where - self.z[index]), index


def _points(z: ComplexArray) -> FloatArray:
    return np.ascontiguousarray(z).view(np.float64).reshape(-1, 2)
