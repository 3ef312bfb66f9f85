"""How far off the vertices of a map may be, together: samples of the posterior of its pose graph.

What a map says of positions is correlated: neighbours share the odometry's errors, far vertices
only where loops tie them. Samples of the whole tell the error of any function of the positions
(a corridor's length, the place of one junction seen from another, a rigid fit) by one product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .frozen import frozen_array

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class VertexErrors:
    """sample: (n, 3, s) errors of x, y [m] and of the map's turn [rad] at each vertex, mean 0.

    The frame in which they are given is arbitrary and common to each sample: only what does not
    depend on it (distances, rigid fits) means anything.
    """

    sample: FloatArray

    def __post_init__(self) -> None:
        sample = frozen_array(self.sample, np.float64, (None, 3, None), "sample")
        object.__setattr__(self, "sample", sample)

    @classmethod
    def none(cls, count: int) -> VertexErrors:
        """No error at all: what is known exactly."""
        return cls(np.zeros((count, 3, 1)))

    def distance_sigma(self, xy: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
        """(k,) 1 sigma [m] of the distance from vertices a to vertices b, which lie at xy (n, 2).

        To first order only errors along the line between the two change it; of vertices that
        coincide the larger of both axes counts.
        """
        step = xy[b] - xy[a]
        distance = np.hypot(*step.T)
        off = self.sample[b, :2] - self.sample[a, :2]
        unit = step / np.maximum(distance, 1e-9)[:, None]
        along = np.sqrt(np.mean((off * unit[:, :, None]).sum(axis=1) ** 2, axis=1))
        either = np.sqrt(np.mean(off**2, axis=2).max(axis=1))
        return np.asarray(np.where(distance > 1e-6, along, either))
