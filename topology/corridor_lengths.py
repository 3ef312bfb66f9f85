"""The length of a corridor, of which several drives tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .arrays import FloatArray, IntArray

LIKE_SIGMAS = 4.0
"""The shortest of a few normal ways is one or two sigmas below their mean, and hardly any lies as
far above the shortest as this."""

_MEDIAN_CHI2 = 0.4549
"""Median of χ² with one degree of freedom."""


def corridor_lengths(
    way: FloatArray, line: FloatArray, sound: Sequence[IntArray]
) -> tuple[FloatArray, IntArray]:
    """(c,) length of each corridor [m], and the leg whose track shows it best.

    way, line: (l,) of every leg, its length and that of the straight line between its ends [m];
    sound: of each corridor, the legs that were driven straight through it, the shortest first.

    Who wanders drives farther, nobody less far: of a straight corridor the shortest way counts. A
    way that bends errs to either side, though, by what the odometry turned wrongly on it, and the
    shortest of several is too short: by 0.7 % of three, where the way is a third longer than the
    line. The variance grows with the bend, which is what a way is longer than its line; how far the
    ways of one corridor differ tells by how much. Where the bend is clearly more than these errors,
    the ways like the shortest count, in the mean.
    """
    bend = np.array([max(float(way[legs[0]] - line[legs[0]]), 1e-9) for legs in sound])
    # One drive and the next: neighbours by length would be nearer to each other than chance.
    apart = [np.diff(way[np.sort(k)]) ** 2 / (2 * b) for k, b in zip(sound, bend, strict=True)]
    told = np.concatenate([np.zeros(0), *apart])
    ratio = float(np.median(told)) / _MEDIAN_CHI2 if len(told) else 0.0
    like_m = LIKE_SIGMAS * np.sqrt(ratio * bend)
    length, leg = np.zeros(len(sound)), np.zeros(len(sound), np.int64)
    for e, legs in enumerate(sound):
        within = like_m[e] if bend[e] > like_m[e] else 0.0
        like = legs[way[legs] <= way[legs[0]] + within]
        length[e] = way[like].mean()
        leg[e] = like[np.abs(way[like] - length[e]).argmin()]
    return length, leg
