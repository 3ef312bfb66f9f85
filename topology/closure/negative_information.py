"""Negative information: ground driven without a detection holds no other junction.

If two places are not one, they are two junctions. If the second one lies on a corridor driven from
the first, the robot passed it and must have missed it. Hoffmann, Spranger, Göhring, Jüngel: Making
Use of What You Don't See: Negative Information in Markov Localization (IROS 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ..arrays import FloatArray, IntArray
from .places import NOWHERE, Places


@dataclass(frozen=True, slots=True, eq=False)
class DrivenGround:
    """Straight corridors that were driven from the two places of k pairs.

    along: (k, 2, s, 2) unit vectors in map axes, along the corridors of the second place, and
    against those of the first: the shift of the first place from the second is along one of them if
    either place lies on that corridor of the other. length: (k, 2, s) distance to the next place
    [m], 0 where there is no such corridor.
    """

    along: FloatArray
    length: FloatArray

    def share(
        self, shift: FloatArray, cov: FloatArray, core_m: float, reach_m: float
    ) -> FloatArray:
        """(k,) probability that one place lies on ground driven from the other, the larger one.

        shift: (k, 2) [m] with covariance cov (k, 2, 2) [m²]; core_m: part of a corridor at either
        end without other junctions [m], which is left out; reach_m: distance from the track up to
        which junctions are reported [m]. Approximation: normal along a corridor, with the mean and
        variance conditional on a place beside its line.
        """
        x, y = shift[:, 0, None, None], shift[:, 1, None, None]
        xx, xy, yy = (cov[:, i, j, None, None] for i, j in ((0, 0), (0, 1), (1, 1)))
        u, v = self.along[..., 0], self.along[..., 1]
        lateral, sigma = y * u - x * v, np.sqrt(xx * v * v - 2 * xy * u * v + yy * u * u)
        low, high = (-reach_m - lateral) / sigma, (reach_m - lateral) / sigma
        beside = np.maximum(ndtr(high) - ndtr(low), np.finfo(np.float64).eps)
        # Mean and variance of a truncated normal, of unit variance if it were not.
        density_low, density_high = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) for z in (low, high))
        mean = (density_low - density_high) / beside
        lost_variance = mean**2 - (low * density_low - high * density_high) / beside
        slope = ((yy - xx) * u * v + xy * (u * u - v * v)) / sigma
        along_m = x * u + y * v + slope * mean
        spread = xx * u * u + 2 * xy * u * v + yy * v * v - slope**2 * lost_variance
        spread = np.sqrt(np.maximum(spread, np.finfo(np.float64).eps))
        end = np.maximum(self.length - core_m, core_m)
        on_ground = beside * (ndtr((end - along_m) / spread) - ndtr((core_m - along_m) / spread))
        return np.asarray(on_ground.sum(axis=2).max(axis=1))


def driven_ground(
    places: Places, xy: FloatArray, a: IntArray, b: IntArray, reach_m: float
) -> DrivenGround:
    """The ground driven around places a and b (k,) in a map with places at `xy` (n, 2) [m].

    A corridor counts as straight if, as an arc, it would keep to its chord within `reach_m` [m].
    """
    driven = places.next_place != NOWHERE
    step = np.where(driven[..., None], xy[places.next_place] - xy[:, None], 0.0)
    chord = np.hypot(step[..., 0], step[..., 1])
    # Length and chord of a flat arc of sagitta s differ by 8 s² / 3 chord.
    sagitta2 = 3 * chord * np.where(driven, places.length - chord, 0.0) / 8
    straight = driven & (sagitta2 < reach_m**2) & (chord > 0)
    length = np.where(straight, chord, 0.0)
    along = (
        np.where(straight[..., None], step, [1.0, 0.0]) / np.where(straight, chord, 1.0)[..., None]
    )
    return DrivenGround(
        np.stack([-along[a], along[b]], axis=1), np.stack([length[a], length[b]], axis=1)
    )
