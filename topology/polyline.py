"""Polylines: (k, 2) arrays of points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .arrays import FloatArray, IntArray


def simplify(path: FloatArray, tolerance: float) -> FloatArray:
    """A polyline with fewer points, within `tolerance` [m] of all points of the path.

    Douglas and Peucker's algorithm; both ends stay, even if they coincide. O(k · points kept).
    """
    keep = np.zeros(len(path), bool)
    keep[[0, -1]] = True
    spans = [(0, len(path) - 1)]
    while spans:
        a, b = spans.pop()
        if b - a < 2:
            continue
        chord, d = path[b] - path[a], path[a + 1 : b] - path[a]
        length2 = float(chord @ chord)
        along = np.clip(d @ chord / length2, 0.0, 1.0) if length2 > 0 else np.zeros(len(d))
        away = np.hypot(*(d - along[:, None] * chord).T)
        worst = int(away.argmax())
        if away[worst] > tolerance:
            middle = a + 1 + worst
            keep[middle] = True
            spans += [(a, middle), (middle, b)]
    return path[keep]


def way_of(path: FloatArray) -> FloatArray:
    """(k,) arc length from the first point of a polyline (k, 2) to each of its points [m]."""
    arc, step = np.zeros(max(len(path), 1)), path[1:] - path[:-1]
    np.cumsum(np.hypot(step[:, 0], step[:, 1]), out=arc[1:])
    return arc


def densely(path: FloatArray, step_m: float) -> FloatArray:
    """(j, 2) points along a polyline, both ends among them, at most `step_m` apart."""
    way = way_of(path)
    arc = np.linspace(0.0, way[-1], 2 + int(way[-1] / step_m))
    return np.stack([np.interp(arc, way, path[:, k]) for k in (0, 1)], axis=-1)


def leaving_rad(path: FloatArray, end: int) -> float:
    """Direction [rad] in which a polyline leaves its first point (end 0) or its last one (end
    1)."""
    x, y = path[1] - path[0] if end == 0 else path[-2] - path[-1]
    return float(np.arctan2(y, x))


def leaving_over(path: FloatArray, way_m: float) -> float:
    """Direction [rad] from the first point of a polyline to the one `way_m` [m] along it, or to its
    end."""
    way = way_of(path)
    x, y = (np.interp(min(way_m, way[-1]), way, path[:, k]) - path[0, k] for k in (0, 1))
    return float(np.arctan2(y, x))


def join_centres(
    track: FloatArray, begin: FloatArray, end: FloatArray, junction_m: float
) -> FloatArray:
    """A corridor between the centres of two junctions, from the track driven between them.

    track: (k, 2); begin, end: (2,) centres [m]. Points within `junction_m` of a centre (cut
    corners, turning round) are dropped, and the corridor is straight there. A track that passes
    beside a centre is shifted onto it; the shift decreases linearly to zero at the other end.
    Returns (j, 2) from `begin` to `end`, straight if the track is a single point.
    """
    if len(track) < 2:
        return np.stack([begin, end])
    way = way_of(track)
    middle = min(max(int(np.count_nonzero(way <= way[-1] / 2)), 1), len(track) - 1)
    reach = min(junction_m, way[-1] / 3)
    first, shift_begin = _past_centre(track[:middle], begin, reach)
    dropped, shift_end = _past_centre(track[middle:][::-1], end, reach)
    inner = track[first : len(track) - dropped]
    way = way_of(inner)[: len(inner), None]
    share = way / max(float(way.max(initial=0.0)), 1e-9)
    return np.concatenate(
        [begin[None], inner - (1 - share) * shift_begin - share * shift_end, end[None]]
    )


def _past_centre(track: FloatArray, centre: FloatArray, reach: float) -> tuple[int, FloatArray]:
    """Index of the first point of a track (k, 2) beyond `reach` [m] of the centre that it starts
    at, or of the nearest point if none is within; and by how much (2,) [m] it passes aside there.

    Outside the reach this is the offset of the nearest point. Else it is the offset of the first
    point, across the direction in which the track goes on, times the share of the reach that the
    track kept off the centre: a track through the centre is not aside where its corridor bends. A
    first point far off (sparse tracks) shifts it no farther than the track kept off the centre.
    """
    distance = np.hypot(*(track - centre).T)
    inside = np.flatnonzero(distance < reach)
    nearest = int(distance.argmin())
    if len(inside) == 0:
        return nearest, track[nearest] - centre
    first = int(inside[-1]) + 1
    beyond = track[first:]
    if len(beyond) < 2:
        return first, np.zeros(2)
    step = max(int(np.count_nonzero(way_of(beyond) < reach)) - 1, 1)
    onward = beyond[step] - beyond[0]
    onward = onward / max(float(np.hypot(*onward)), 1e-9)
    offset = beyond[0] - centre
    lateral = offset - (offset @ onward) * onward
    return first, lateral * float(distance[nearest]) / max(reach, float(np.hypot(*lateral)))


def loop_erased(path: FloatArray, near_m: float) -> FloatArray:
    """A path (k, 2) without its detours: where it first comes back to within `near_m` [m] of an
    earlier point, the points between are removed.

    Only returns after more than three times `near_m` of driving count, so that tight bends stay. Of
    a place visited several times, the way out and the last way back remain. O(k log k), however
    often the path comes back.
    """
    from scipy.spatial import cKDTree

    if len(path) < 2:
        return path
    way = way_of(path)
    may_come_back = way[_last_about(path, near_m)] - way > 3 * near_m
    if not may_come_back.any():
        return path
    tree = cKDTree(path)
    kept, k = [], 0
    while k < len(path):
        kept.append(k)
        near = np.array(tree.query_ball_point(path[k], near_m) if may_come_back[k] else [k])
        back = int(near[way[near] - way[k] > 3 * near_m].max(initial=k))
        k = back if back > k else k + 1
    return path if len(kept) == len(path) else path[kept]


def _last_about(path: FloatArray, near_m: float) -> IntArray:
    """(k,) upper bound of the index of the last point within `near_m` of each point: the last one
    in the 3 × 3 grid cells around it."""
    x, y = np.floor((path - path.min(axis=0)) / near_m).astype(np.int64).T
    width = int(y.max()) + 3
    square = x * width + y
    last = dict(zip(square.tolist(), range(len(path)), strict=True))
    keys = np.array(sorted(last))
    rows = np.array([last[key] for key in keys.tolist()])
    last_index = np.arange(len(path))
    for aside in (-width, 0, width):
        for step in (-1, 0, 1):
            cell = square + aside + step
            row = np.minimum(np.searchsorted(keys, cell), len(keys) - 1)
            last_index = np.maximum(last_index, np.where(keys[row] == cell, rows[row], 0))
    return last_index


def loop_width(path: FloatArray) -> float:
    """Mean distance [m] between the way out and the way back of a closed path: twice its enclosed
    area over its length. Parts with the opposite orientation are subtracted."""
    x, y = (path - path[0]).T
    area = abs(float(x[:-1] @ y[1:] - x[1:] @ y[:-1])) / 2
    return 2 * area / max(float(way_of(path)[-1]), 1e-9)


def with_corners(path: FloatArray, reach_m: float, least_rad: float) -> FloatArray:
    """A driven path whose tight turns are replaced by corners: where the lines before and after
    meet.

    A turn is tight if it amounts to `least_rad` [rad] or more within `reach_m` [m] to either side:
    there a robot cuts the corner of a corridor, by about 0.1 m at a right angle.
    """
    way = way_of(path)
    x, y = path.T

    def at(s: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(s, way, x), np.interp(s, way, y)])

    inner = way[(way > 1.5 * reach_m) & (way < way[-1] - 1.5 * reach_m)]
    if len(inner) == 0:
        return path
    before, after = at(inner - reach_m), at(inner + reach_m)
    into, out = before - at(inner - 2 * reach_m), at(inner + 2 * reach_m) - after
    cross = into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]
    turn = np.abs(np.arctan2(cross, (into * out).sum(axis=1)))
    kept, corners = np.ones(len(path), bool), []
    while True:
        i = int(turn.argmax())
        if turn[i] < least_rad:
            break
        gap = after[i] - before[i]
        along = (gap[0] * out[i, 1] - gap[1] * out[i, 0]) / cross[i] if cross[i] else -1.0
        corner = before[i] + along * into[i]
        if (
            along > 0
            and (after[i] - corner) @ out[i] > 0
            and np.hypot(*(corner - after[i])) < 2 * reach_m
        ):
            kept &= np.abs(way - inner[i]) >= reach_m
            corners.append((float(inner[i]), corner))
        turn[np.abs(inner - inner[i]) < 2 * reach_m] = 0.0
    if not corners:
        return path
    arc = np.concatenate([way[kept], [s for s, _ in corners]])
    points = np.concatenate([path[kept], [c for _, c in corners]])
    return np.asarray(points[np.argsort(arc, kind="stable")])


class Ways:
    """Nearest-neighbour search on polylines."""

    def __init__(self, paths: Sequence[FloatArray], step_m: float) -> None:
        """step_m: spacing [m] of the points by which a path is represented. O(k log k) in their
        number."""
        from scipy.spatial import cKDTree

        dense = [densely(path, step_m) for path in paths]
        self._step_m = step_m
        self._tree = cKDTree(np.concatenate(dense)) if dense else None

    def away(self, path: FloatArray) -> FloatArray:
        """(m,) distances [m] of points along a path from the polylines, inf if there are none."""
        return self.nearest(densely(path, self._step_m))

    def nearest(self, points: FloatArray) -> FloatArray:
        """(m,) distances [m] of points (m, 2) from the polylines, inf if there are none."""
        if self._tree is None:
            return np.full(len(points), np.inf)
        return np.asarray(self._tree.query(points)[0], np.float64)
