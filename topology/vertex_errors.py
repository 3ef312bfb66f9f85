"""How far off the vertices of a map may be, together: samples of the posterior of its pose graph.

What a map says of positions is correlated: neighbours share the odometry's errors, far vertices
only where loops tie them. Samples of the whole tell the error of any function of the positions
(a corridor's length, the place of one junction seen from another, a rigid fit) by one product.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .arrays import FloatArray, IntArray
from .frozen import freeze


@dataclass(frozen=True, slots=True, eq=False)
class VertexErrors:
    """sample: (n, 3, s) errors of x, y [m] and of the map's turn [rad] at each vertex, mean 0.

    own: (n,) how much of what fixes the turn at a vertex are readings of its own branches, 0 to 1.

    The frame in which they are given is arbitrary and common to each sample: only what does not
    depend on it (distances, rigid fits) means anything.
    """

    sample: FloatArray
    own: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        freeze(self, np.float64, sample=(None, 3, None))
        if len(self.own) == 0:  # left out
            object.__setattr__(self, "own", np.zeros(len(self.sample)))
        freeze(self, np.float64, own=(len(self.sample),))

    def distance_errors(self, xy: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
        """(k, s) errors [m] of the distance from vertices a to vertices b, which lie at xy (n, 2):
        to first order those along the line between the two, 0 where they coincide."""
        step = xy[b] - xy[a]
        unit = step / np.maximum(np.hypot(*step.T), 1e-9)[:, None]
        off = self.sample[b, :2] - self.sample[a, :2]
        return np.asarray((off * unit[:, :, None]).sum(axis=1))

    def distance_sigma(self, xy: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
        """(k,) 1 sigma [m] of these distances; of vertices that coincide the larger of both axes
        counts."""
        along = np.sqrt(np.mean(self.distance_errors(xy, a, b) ** 2, axis=1))
        off = self.sample[b, :2] - self.sample[a, :2]
        either = np.sqrt(np.mean(off**2, axis=2).max(axis=1))
        return np.asarray(np.where(np.hypot(*(xy[b] - xy[a]).T) > 1e-6, along, either))

    def as_a_whole(self, xy: FloatArray, piece: IntArray) -> VertexErrors:
        """The errors that are left when a map is laid rigidly over the truth: those of its shape.

        xy: (n, 2) vertices; piece: (n,) number of the rigid body that each is part of.
        """
        out = self.sample.copy()
        for k in np.unique(piece):
            rows = piece == k
            out[rows] = _without_rigid_motion(out[rows], xy[rows])
        return VertexErrors(out, self.own)

    def position_sigma(self) -> FloatArray:
        """(n,) 1 sigma [m] of each coordinate, the mean of both."""
        return np.asarray(np.sqrt(np.mean(self.sample[:, :2] ** 2, axis=(1, 2))))

    def turn_sigma(self) -> FloatArray:
        """(n,) 1 sigma [rad] of the map's turn at each vertex."""
        return np.asarray(np.sqrt(np.mean(self.sample[:, 2] ** 2, axis=1)))

    def branch_sigma(self, owner: IntArray, reading: FloatArray) -> FloatArray:
        """(b,) 1 sigma [rad] of branch headings, each of vertex `owner` and read to `reading`
        [rad].

        Where the building's grid fixes the turn at a vertex by the branches' own readings, the
        errors of both cancel in part: with variances r of a reading and s of the turn, cov = -s ·
        own. No less than half of the reading's own sigma.
        """
        turn = self.turn_sigma() ** 2 * (1 - 2 * self.own)
        return np.asarray(np.sqrt(np.maximum(reading**2 + turn[owner], 0.25 * reading**2)))


def _without_rigid_motion(sample: FloatArray, xy: FloatArray) -> FloatArray:
    """(n, 3, s) errors less the shift and turn that fit them best; of one vertex, all of them."""
    arm = xy - xy.mean(axis=0)
    out = sample.copy()
    out[:, :2] -= sample[:, :2].mean(axis=0)
    reach = float((arm**2).sum())
    turn = sample[:, 2].mean(axis=0)
    if reach > 0:
        lever = np.column_stack([-arm[:, 1], arm[:, 0]])
        turn = np.einsum("nk,nks->s", lever, out[:, :2]) / reach
        out[:, :2] -= lever[:, :, None] * turn
    out[:, 2] -= turn
    return out
