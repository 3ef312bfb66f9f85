"""The length of a corridor, of which several drives tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .arrays import FloatArray, IntArray
from .se2 import wrap
from .topomap import RunNoise, TopoMap

LIKE_SIGMAS = 4.0
"""The shortest of a few normal ways is one or two sigmas below their mean, and hardly any lies as
far above the shortest as this."""

LEAST_M = 0.001
"""No length is known better, which is what documents are rounded to."""

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
        # Two are equally far from their mean: it is not rounding that chooses, but the shorter way.
        leg[e] = like[np.round(np.abs(way[like] - length[e]) / LEAST_M).argmin()]
    return length, leg


def straightness(
    xy: FloatArray, source: IntArray, target: IntArray, length: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(m,) chords [m] of corridors between vertices that lie at xy (n, 2), and their shares in the
    lengths (m,) of the corridors, 1 at most."""
    chord = np.hypot(*(xy[target] - xy[source]).T)
    return chord, np.minimum(chord / length, 1.0)


def turning_variance(paths: Sequence[FloatArray], noise: RunNoise) -> FloatArray:
    """(m,) variance [m²] of how far apart the ends of m polylines (k, 2) lie, by what an odometry
    turned wrongly on one drive: ∫ h² dq, with h the offset from the chord and q the variance of the
    heading. A wrong turn moves the far end along the chord by as much times the offset."""
    size = np.array([len(path) for path in paths], np.int64)
    owner, last = np.repeat(np.arange(len(paths)), size), np.cumsum(size) - 1
    points = np.concatenate([np.zeros((0, 2)), *paths])
    begin = points[last - size + 1]
    chord = points[last] - begin
    unit = chord / np.maximum(np.hypot(*chord.T), 1e-9)[:, None]
    x, y = (points - begin[owner]).T
    off = unit[owner, 0] * y - unit[owner, 1] * x
    step, along = np.diff(points, axis=0), owner[1:] == owner[:-1]
    square = (off[:-1] ** 2 + off[:-1] * off[1:] + off[1:] ** 2) / 3
    heading = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs(wrap(np.diff(heading))) * (along[1:] & along[:-1])
    on_the_way = np.bincount(owner[1:], along * np.hypot(*step.T) * square, len(paths))
    turning = np.bincount(owner[1:-1], turn * off[1:-1] ** 2, len(paths))
    walk, swing = noise.heading_rad_per_sqrt_m**2, noise.heading_rad_per_sqrt_rad**2
    return np.asarray(walk * on_the_way + swing * turning)


def way_sigma(topomap: TopoMap) -> FloatArray:
    """(m,) 1 sigma [m] of a map's lengths, were the ends of its corridors and the scale of its
    odometry known.

    What odometry does on ways that wind is known, what robots wandered is the rest of what the map
    states: beyond that, the scale, and the errors of both ends by this corridor alone; and not
    more than the corridor is longer than the line between them.
    """
    noise, length, times = topomap.measured, topomap.length, np.maximum(topomap.traversals, 1)
    ends = topomap.source, topomap.target
    chord, straight = straightness(topomap.xy, *ends, length)
    along = noise.along_m_per_sqrt_m**2 * length
    turned = turning_variance(topomap.paths, noise)
    driven = ((1 - straight**2) * along + straight**2 * turned) / times
    seen = topomap.centre_variance
    apart = (along + turned) / times + seen[ends[0]] + seen[ends[1]]
    rest = topomap.length_sigma**2 - (noise.scale * length) ** 2 - straight**2 * apart
    beyond = np.maximum(length - chord, 0.0)
    return np.asarray(np.sqrt(np.clip(rest, driven, driven + beyond**2 / times)))
