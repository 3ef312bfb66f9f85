"""Joint errors of the vertices of a map, as samples of the posterior of its pose graph.

Position errors are correlated: neighbouring vertices share the odometry's errors, distant ones only
where loops tie them. From samples, the error of any function of the positions (the length of a
corridor, the position of one junction relative to another, a rigid fit) follows by one product.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .arrays import FloatArray, IntArray
from .frozen import freeze


@dataclass(frozen=True, slots=True, eq=False)
class VertexErrors:
    """Samples of the joint error of all vertices.

    sample: (n, 3, s) errors of x, y [m] and of the map's rotation [rad] at each vertex, mean 0;
    own: (n,) in [0, 1], share of the information on the rotation at a vertex that is from its own
    branches. The samples have an arbitrary common frame each: only functions that do not depend on
    it (distances, rigid fits) are meaningful.
    """

    sample: FloatArray
    own: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        freeze(self, np.float64, sample=(None, 3, None))
        if len(self.own) == 0:  # left out
            object.__setattr__(self, "own", np.zeros(len(self.sample)))
        freeze(self, np.float64, own=(len(self.sample),))

    def distance_errors(self, xy: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
        """(k, s) errors [m] of the distances between vertices a and b (k,), with xy (n, 2) the
        positions: to first order the error along the connecting line; 0 where they coincide."""
        step = xy[b] - xy[a]
        unit = step / np.maximum(np.hypot(*step.T), 1e-9)[:, None]
        difference = self.sample[b, :2] - self.sample[a, :2]
        return np.asarray((difference * unit[:, :, None]).sum(axis=1))

    def distance_sigma(self, xy: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
        """(k,) 1 sigma [m] of these distances; for vertices that coincide, the larger one of both
        axes."""
        along = np.sqrt(np.mean(self.distance_errors(xy, a, b) ** 2, axis=1))
        difference = self.sample[b, :2] - self.sample[a, :2]
        larger = np.sqrt(np.mean(difference**2, axis=2).max(axis=1))
        return np.asarray(np.where(np.hypot(*(xy[b] - xy[a]).T) > 1e-6, along, larger))

    def as_a_whole(self, xy: FloatArray, piece: IntArray) -> VertexErrors:
        """The errors that remain after aligning the map rigidly to the truth.

        xy: (n, 2) positions; piece: (n,) rigid piece of each vertex, aligned separately.
        """
        aligned = self.sample.copy()
        for k in np.unique(piece):
            rows = piece == k
            aligned[rows] = _without_rigid_motion(aligned[rows], xy[rows])
        return VertexErrors(aligned, self.own)

    def position_sigma(self) -> FloatArray:
        """(n,) 1 sigma [m] per coordinate, root mean square of both."""
        return np.asarray(np.sqrt(np.mean(self.sample[:, :2] ** 2, axis=(1, 2))))

    def turn_sigma(self) -> FloatArray:
        """(n,) 1 sigma [rad] of the map's rotation at each vertex."""
        return np.asarray(np.sqrt(np.mean(self.sample[:, 2] ** 2, axis=1)))

    def branch_sigma(self, owner: IntArray, reading: FloatArray) -> FloatArray:
        """(b,) 1 sigma [rad] of the headings of branches in the map.

        owner: (b,) vertex of each branch; reading: (b,) 1 sigma of its reading [rad]. Where the
        building's grid fixes the rotation at a vertex by the readings of its own branches, the two
        errors cancel in part: with variances r of a reading and s of the rotation, cov = -s · own.
        The result is at least half of the reading's own sigma.
        """
        turn = self.turn_sigma() ** 2 * (1 - 2 * self.own)
        return np.asarray(np.sqrt(np.maximum(reading**2 + turn[owner], (0.5 * reading) ** 2)))


def _without_rigid_motion(sample: FloatArray, xy: FloatArray) -> FloatArray:
    """(n, 3, s) errors minus the best-fitting shift and rotation; of a single vertex all is
    removed."""
    offset = xy - xy.mean(axis=0)
    residual = sample.copy()
    residual[:, :2] -= sample[:, :2].mean(axis=0)
    inertia = float((offset**2).sum())
    turn = sample[:, 2].mean(axis=0)
    if inertia > 0:
        lever = np.column_stack([-offset[:, 1], offset[:, 0]])
        turn = np.einsum("nk,nks->s", lever, residual[:, :2]) / inertia
        residual[:, :2] -= lever[:, :, None] * turn
    residual[:, 2] -= turn
    return residual
