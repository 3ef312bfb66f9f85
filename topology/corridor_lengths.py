"""Lengths of corridors from several drives, and their errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .arrays import FloatArray, IntArray
from .digits import METRES
from .quadratic_forms import MEDIAN_CHI2
from .se2 import wrap
from .topomap import RunNoise, TopoMap

LIKE_SIGMAS = 4.0
"""Largest difference of lengths of drives without detours, in standard deviations: the shortest
of a few normal values is one or two below the mean, and few are this far above it."""

LEAST_M = 10.0**-METRES
"""Lower bound of length errors: the precision of documents."""

EXPLAINED = 2.0
"""Largest ratio of the variance of a chord to that by odometry and centres, for 98 % of the
corridors of runs with drift up to mid."""


def corridor_lengths(
    way: FloatArray, line: FloatArray, sound: Sequence[IntArray]
) -> tuple[FloatArray, IntArray]:
    """(c,) length of each corridor [m], and (c,) the leg whose track represents it.

    way, line: (l,) length of each leg and of the straight line between its ends [m]; sound: for
    each corridor the legs that were driven straight through it, shortest first.

    Wandering only lengthens a drive, so that the shortest drive is used for straight corridors. In
    a bent corridor heading errors of the odometry change the measured length in both directions,
    and the minimum of several drives is biased: by -0.7 % for three, where the length is a third
    more than the line. Their variance is taken as proportional to the bend (length minus line),
    with the factor estimated from the differences of drives through one corridor (a median, over
    all corridors). If the bend exceeds LIKE_SIGMAS of these errors, the mean over the legs within
    that of the shortest is used.
    """
    bend = np.array([max(float(way[legs[0]] - line[legs[0]]), 1e-9) for legs in sound])
    # Differences of drives in order of time: sorted by length they would be too small.
    variances = [np.diff(way[np.sort(k)]) ** 2 / (2 * b) for k, b in zip(sound, bend, strict=True)]
    ratios = np.concatenate([np.zeros(0), *variances])
    ratio = float(np.median(ratios)) / MEDIAN_CHI2 if len(ratios) else 0.0
    like_m = LIKE_SIGMAS * np.sqrt(ratio * bend)
    length, leg = np.zeros(len(sound)), np.zeros(len(sound), np.int64)
    for e, legs in enumerate(sound):
        tolerance = like_m[e] if bend[e] > like_m[e] else 0.0
        alike = legs[way[legs] <= way[legs[0]] + tolerance]
        length[e] = way[alike].mean()
        # Two legs are equally far from their mean: rounded, so that the shorter one is chosen.
        leg[e] = alike[np.round(np.abs(way[alike] - length[e]) / LEAST_M).argmin()]
    return length, leg


def straightness(
    xy: FloatArray, source: IntArray, target: IntArray, length: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(m,) chords [m] of corridors between vertices at xy (n, 2), and their shares (at most 1) of
    the corridors' lengths (m,)."""
    chord = np.hypot(*(xy[target] - xy[source]).T)
    return chord, np.minimum(chord / length, 1.0)


def turning_variance(paths: Sequence[FloatArray], noise: RunNoise) -> FloatArray:
    """(m,) variance of the chord of m polylines (k, 2) by the heading errors of one drive [m²]: ∫
    h² dq, with h the offset from the chord and q the variance of the heading. A heading error dθ at
    offset h moves the far end by h dθ along the chord."""
    size = np.array([len(path) for path in paths], np.int64)
    owner, last = np.repeat(np.arange(len(paths)), size), np.cumsum(size) - 1
    points = np.concatenate([np.zeros((0, 2)), *paths])
    begin = points[last - size + 1]
    chord = points[last] - begin
    unit = chord / np.maximum(np.hypot(*chord.T), 1e-9)[:, None]
    x, y = (points - begin[owner]).T
    offset = unit[owner, 0] * y - unit[owner, 1] * x
    step, same_path = np.diff(points, axis=0), owner[1:] == owner[:-1]
    square = (offset[:-1] ** 2 + offset[:-1] * offset[1:] + offset[1:] ** 2) / 3
    heading = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs(wrap(np.diff(heading))) * (same_path[1:] & same_path[:-1])
    on_the_way = np.bincount(owner[1:], same_path * np.hypot(*step.T) * square, len(paths))
    turning = np.bincount(owner[1:-1], turn * offset[1:-1] ** 2, len(paths))
    per_metre, per_radian = noise.heading_rad_per_sqrt_m**2, noise.heading_rad_per_sqrt_rad**2
    return np.asarray(per_metre * on_the_way + per_radian * turning)


def length_variances(topomap: TopoMap) -> tuple[FloatArray, FloatArray]:
    """Two parts of the variances of a map's lengths (`length_sigma`) [m²].

    (m,) of the way, if the ends of the corridors and the scale of the odometry were known; (m,) of
    the chord, beyond the errors of the odometry and of both centres: not 0 where loop closure
    discounted the drives, because they contradict the rest of the map. 0 for maps from scans: a
    centre that is seen badly by all passes states as much.

    The variance of the scale and that of both ends (as far as this corridor alone determines them)
    are subtracted. What remains is the way's: at least the odometry's error on a bent path, and at
    most that plus, as detours, the square of the length beyond the chord, over the traversals.
    Anything beyond is the chord's.
    """
    noise, length, times = topomap.measured, topomap.length, np.maximum(topomap.traversals, 1)
    ends = topomap.source, topomap.target
    chord, straight = straightness(topomap.xy, *ends, length)
    along = noise.along_m_per_sqrt_m**2 * length
    turned = turning_variance(topomap.paths, noise)
    driven = ((1 - straight**2) * along + straight**2 * turned) / times
    seen = topomap.centre_variance
    apart = (along + turned) / times + seen[ends[0]] + seen[ends[1]]
    rest = topomap.length_sigma**2 - LEAST_M**2 - (noise.scale * length) ** 2
    rest -= straight**2 * apart
    beyond = np.maximum(length - chord, 0.0)
    way = np.clip(rest, driven, driven + beyond**2 / times)
    chord_variance = apart + (rest - way) / np.maximum(straight, LEAST_M) ** 2
    # Of junctions that all passes see alike, some are seen much worse than the run's median.
    explained = EXPLAINED * apart if noise.shared_centre_m == 0 else np.inf
    return way, np.maximum(chord_variance - explained, 0.0)
