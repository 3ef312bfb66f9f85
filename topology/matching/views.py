"""Registration of views, and the evidence in their agreement.

Two views of one place, laid over each other, agree: the walls of each lie on walls of the other, or
where the other saw nothing. Walls of one in the free space of the other contradict it (as in
Millane et al., Free-Space Features, arXiv:1908.01863). The log of the ratio of wall cells,

    z = ln (agreeing + 1) / (contradicting + 1),

of both views, is compared with that of other places of the same maps (`ViewNull`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from ..arrays import ComplexArray, FloatArray, IntArray
from ..columns import take
from ..views import CELL_M, FREE, REACH_M, SIDE, WALL, Views
from .likelihood import BIT

FINE_M = CELL_M / 2
"""Cell of the fields that points are looked up in."""
COARSE_M = 2 * CELL_M
"""Cell of the correlation that finds initial shifts."""
PADDED = 64
"""Coarse cells along the side of a padded view: shifts up to 9 m do not wrap around."""
TURN_RAD = np.pi / 36
"""Step of the turns that are tried: it moves a wall at the rim by less than two coarse cells."""
AGREE_M, CONTRADICT_M = 0.2, 0.32
"""A wall cell agrees up to the first distance from a wall of the other view. It contradicts from
the second distance on, in free space. In between it is no evidence. From a study of five buildings,
with cells of 0.1 and 0.2 m."""
STARTS = 2
"""Coarse shifts that are refined, the best."""

SILENT, AGREES, CONTRADICTS = 0, 1, 2
"""Evidence of a wall cell of one view by another view, and of the fine cells of that view."""


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """The registrations of k pairs of views.

    transform: (k, 3) pose of the second view in the frame of the first; agree, contradict: (k,)
    numbers of wall cells of both that agree and contradict; information: (k, 3, 3) matrix of the
    transform, in the axes of the first view: hardly any along bare corridors.
    """

    transform: FloatArray
    agree: IntArray
    contradict: IntArray
    information: FloatArray

    @property
    def z(self) -> FloatArray:
        """(k,) log ratio of agreement to contradiction."""
        return np.asarray(np.log((self.agree + 1.0) / (self.contradict + 1.0)))

    @property
    def detail(self) -> FloatArray:
        """(k,) information of the shift in its least certain direction [1/m²]."""
        return np.asarray(np.linalg.eigvalsh(self.information[:, :2, :2])[:, 0])


@dataclass(frozen=True, eq=False)
class ViewIndex:
    """Views prepared for registration.

    points: (n, m) wall cells, x + iy [m], padded by zeros; normal: (n, m) squared directions across
    the walls, from 0 where a wall is round to unit numbers where it is straight; is_point: (n, m)
    False for padding; nearest_wall: (n, f, f) the wall cell nearest to each fine cell, as a row of
    `_CELL_CENTRES`; kind: (n, f, f) whether a wall of another view agrees or contradicts in each
    fine cell; fit_coarse: (n, c, c) how well a wall of another view fits in each coarse cell.
    """

    points: NDArray[np.complex64]
    normal: NDArray[np.complex64]
    is_point: NDArray[np.bool_]
    nearest_wall: NDArray[np.uint16]
    kind: NDArray[np.uint8]
    fit_coarse: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of(cls, views: Views) -> ViewIndex:
        """Prepare views. About 3 ms and 100 kB each."""
        n, side = len(views), 2 * SIDE
        count = (views.cells == WALL).sum(axis=(1, 2))
        longest = int(count.max(initial=0))
        points = np.zeros((n, longest), np.complex64)
        normal = np.zeros((n, longest), np.complex64)
        nearest_wall = np.full((n, side, side), side * side, np.uint16)
        kind = np.zeros((n, side, side), np.uint8)
        coarse = SIDE // 2
        fit_coarse = np.zeros((n, coarse, coarse), np.float32)
        for k, cells in enumerate(views.cells):
            row, column = np.nonzero(cells == WALL)
            points[k, : len(row)] = _metres(column, CELL_M) + 1j * _metres(row, CELL_M)
            if not len(row):
                continue
            normal[k, : len(row)] = _normals(cells == WALL)[row, column]
            fine_cells = cells.repeat(2, axis=0).repeat(2, axis=1)
            is_free, is_wall = fine_cells == FREE, fine_cells == WALL
            distance_m, (y, x) = ndimage.distance_transform_edt(~is_wall, return_indices=True)
            nearest_wall[k] = y * side + x
            distance_m *= FINE_M
            kind[k] = np.where(
                distance_m <= AGREE_M + 1e-9,
                AGREES,
                np.where(is_free & (distance_m > CONTRADICT_M), CONTRADICTS, SILENT),
            )
            fit = 1.6 * np.exp(-0.5 * (distance_m / 0.26) ** 2) - 0.6
            unseen_fit = np.where(distance_m > 0.5, 0, np.maximum(fit, 0))
            fit = np.where(is_free | is_wall, fit, unseen_fit)
            rows_of_four = fit.reshape(coarse, 4, side).max(axis=1)
            fit_coarse[k] = rows_of_four.reshape(coarse, coarse, 4).max(axis=2)
        return cls(
            points, normal, np.arange(longest) < count[:, None], nearest_wall, kind, fit_coarse
        )

    @cached_property
    def spectrum(self) -> NDArray[np.complex64]:
        """(n, PADDED, PADDED / 2 + 1) Fourier transforms of `fit_coarse`."""
        return np.asarray(fft.rfft2(self.fit_coarse, (PADDED, PADDED)))

    def turned_spectra(self, row: int, turns: FloatArray) -> NDArray[np.complex64]:
        """(t, PADDED, PADDED / 2 + 1) conjugate Fourier transforms of the walls of one view,
        rotated by each of the turns (t,) [rad]."""
        points = self.points[row, self.is_point[row]]
        turned = np.exp(1j * turns)[:, None] * points
        x = ((turned.real + REACH_M) / COARSE_M).astype(np.int64)
        y = ((turned.imag + REACH_M) / COARSE_M).astype(np.int64)
        last = SIDE // 2 - 1
        image = np.zeros((len(turns), PADDED, PADDED), np.float32)
        image[np.arange(len(turns))[:, None], np.clip(y, 0, last), np.clip(x, 0, last)] = 1.0
        return np.asarray(np.conj(fft.rfft2(image)))


def _metres(cell: IntArray, size_m: float) -> FloatArray:
    return np.asarray((cell + 0.5) * size_m - REACH_M)


def _cell_centres() -> NDArray[np.complex64]:
    """Centres of all fine cells, x + iy [m], and 0 for a view without walls."""
    axis = _metres(np.arange(2 * SIDE), FINE_M)
    return np.append(axis + 1j * axis[:, None], 0.0).astype(np.complex64)


_CELL_CENTRES = _cell_centres()


def _normals(wall: NDArray[np.bool_]) -> ComplexArray:
    """(s, s) squared direction across the walls of a view at each cell, with the straightness of
    the wall as its absolute value, 0 to 1: structure tensor (Förstner, Gülch 1987)."""
    soft = ndimage.gaussian_filter(wall.astype(np.float64), 1.0)
    dy, dx = np.gradient(soft)
    double = (dx + 1j * dy) ** 2
    parts = (double.real, double.imag, np.abs(double))
    real, imag, total = (ndimage.gaussian_filter(part, 1.5) for part in parts)
    return np.asarray((real + 1j * imag) / np.maximum(total, 1e-12))


def register(
    a: ViewIndex,
    b: ViewIndex,
    first: IntArray,
    second: IntArray,
    turns: FloatArray,
    *,
    reach_m: float = 1.2,
    centre: FloatArray | None = None,
) -> Registered:
    """Register views `second` (k,) of b with views `first` (k,) of a.

    turns: (k, t) rotations from b to a that are tried [rad]; reach_m: largest shift along either
    axis, from `centre` (k, 2) [m] (zero by default).
    """
    pairs = _Pairs(a, b, first, second)
    shift, turn, _ = _coarse_search(pairs, turns, reach_m, centre)
    starts = pairs.repeated(STARTS)
    start_shift, start_turn = _refine(starts, shift.reshape(-1), turn.reshape(-1))
    registered = _count_agreement(starts, start_shift, start_turn)
    z = registered.z.reshape(-1, STARTS)
    cells = (registered.agree + registered.contradict).reshape(-1, STARTS)
    best = np.argmax(z + 1e-6 * (z * np.sqrt(cells + 1.0)), axis=1)
    return take(registered, np.arange(len(first)) * STARTS + best)


def coarse_fit(
    index: ViewIndex, first: IntArray, second: IntArray, turns: FloatArray, reach_m: float
) -> FloatArray:
    """(k,) mean fit, at most 1, of the walls of views `second` (k,) to views `first` (k,), at the
    best of the turns (k, t) and of the shifts within `reach_m`. It takes a tenth of the time of
    `register`, and chooses the pairs for it."""
    return _coarse_search(_Pairs(index, index, first, second), turns, reach_m, None)[2]


class _Pairs(NamedTuple):
    """Views `first` (k,) of a and `second` (k,) of b."""

    a: ViewIndex
    b: ViewIndex
    first: IntArray
    second: IntArray

    def repeated(self, times: int) -> _Pairs:
        return _Pairs(self.a, self.b, self.first.repeat(times), self.second.repeat(times))

    def batches(self) -> Iterator[tuple[slice, IntArray, IntArray]]:
        """The pairs in batches that fit the cache: rows, `first` and `second` of each."""
        for begin in range(0, len(self.first), _AT_ONCE):
            rows = slice(begin, begin + _AT_ONCE)
            yield rows, self.first[rows], self.second[rows]


def _coarse_search(
    pairs: _Pairs, turns: FloatArray, reach_m: float, centre: FloatArray | None
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """(k, STARTS) each: shifts, x + iy [m], and turns [rad] with the best coarse correlation, of
    different turns; (k,) the best correlation, as a mean over the walls of the second view."""
    a, b, first, second = pairs
    k, t = turns.shape
    fit = np.zeros(k)
    shift = np.zeros((k, STARTS), np.complex128)
    turn = np.repeat(turns[:, :1], STARTS, axis=1)
    half = round(reach_m / COARSE_M)
    window = np.arange(-half, half + 1)
    middle = np.zeros((k, 2), np.int64)
    if centre is not None:
        middle = np.rint(centre / COARSE_M).astype(np.int64)
    number = np.rint(turns / TURN_RAD).astype(np.int64) % round(2 * np.pi / TURN_RAD)
    order = np.argsort(second, kind="stable")
    # View by view of b, so that each is rotated once for all its pairs.
    for of_view in np.split(order, np.flatnonzero(np.diff(second[order])) + 1):
        if not len(of_view):
            continue
        raster, column = np.unique(number[of_view], return_inverse=True)
        spectra = b.turned_spectra(int(second[of_view[0]]), np.asarray(raster * TURN_RAD))
        column = column.reshape(len(of_view), t)
        for batch in np.array_split(np.arange(len(of_view)), -(-len(of_view) * t // 2048)):
            rows = of_view[batch]
            product = a.spectrum[first[rows], None] * spectra[column[batch]]
            score = _window_scores(product, middle[rows], window)
            best_cell, best_score = score.argmax(axis=2), score.max(axis=2)
            fit[rows] = best_score.max(axis=1) / max(int(spectra[0, 0, 0].real), 1)
            row = np.arange(len(rows))
            for start in range(STARTS):
                best_turn = best_score.argmax(axis=1)
                cell = best_cell[row, best_turn]
                dy, dx = window[cell // len(window)], window[cell % len(window)]
                cells = (middle[rows, 0] + dx) + 1j * (middle[rows, 1] + dy)
                shift[rows, start] = cells * COARSE_M
                turn[rows, start] = number[rows, best_turn] * TURN_RAD
                best_score[row, best_turn] = -np.inf
    return shift, turn, fit


def _window_scores(
    product: NDArray[np.complex64], middle: IntArray, window: IntArray
) -> NDArray[np.float32]:
    """(r, t, w²) correlations at the shifts middle + window (w,) of y and x [coarse cells], in rows
    of equal y. product: (r, t, …) their Fourier transforms, overwritten; middle: (r, 2) x, y."""
    score = fft.irfft2(product, (PADDED, PADDED), overwrite_x=True)
    y = (middle[:, 1, None] + window) % PADDED
    x = (middle[:, 0, None] + window) % PADDED
    i, j = np.arange(len(score))[:, None, None, None], np.arange(score.shape[1])[:, None, None]
    inside = score[i, j, y[:, None, :, None], x[:, None, None, :]]
    return np.asarray(inside.reshape(*score.shape[:2], -1))


SIGMAS_M = (0.4, 0.4, 0.3, 0.3, 0.2, 0.2, 0.2, 0.13, 0.13, 0.13)
"""1 sigma of the weights in each iteration of the refinement: from a coarse cell to the noise. With
half as many iterations errors are 1.5 times as large, with 15 a tenth less."""
LEAST_POINTS = 120
"""About so many points of a view are used before the last two iterations."""
_AT_ONCE = 256
"""Pairs in a batch that fits the cache."""


def _refine(
    pairs: _Pairs, shift: ComplexArray, turn: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    """Shifts and turns after iterated closest points (ICP), both ways, with Gaussian weights."""
    a, b, *_ = pairs
    for batch, i, j in pairs.batches():
        s = shift[batch, None].astype(np.complex64)
        r = np.exp(1j * turn[batch, None]).astype(np.complex64)
        for iteration, sigma_m in enumerate(SIGMAS_M):
            last = iteration >= len(SIGMAS_M) - 2
            step = [1 if last else max(m.points.shape[1] // LEAST_POINTS, 1) for m in (a, b)]
            wall_a, used_a = a.points[i, :: step[0]], a.is_point[i, :: step[0]]
            wall_b, used_b = b.points[j, :: step[1]], b.is_point[j, :: step[1]]
            wall_b_in_a = r * wall_b + s
            to_a, inside_a = _offset_to_wall(a.nearest_wall, i, wall_b_in_a)
            wall_a_in_b = np.conj(r) * (wall_a - s)
            to_b, inside_b = _offset_to_wall(b.nearest_wall, j, wall_a_in_b)
            # Pairs of points: of b's walls with a's nearest, and of a's walls with b's nearest.
            points_a = np.concatenate([wall_b_in_a + to_a, wall_a], axis=1)
            points_b = np.concatenate([wall_b, wall_a_in_b + to_b], axis=1)
            weight_b = (used_b & inside_a) * _weight(to_a, sigma_m)
            weight_a = (used_a & inside_b) * _weight(to_b, sigma_m)
            weight = np.concatenate([weight_b, weight_a], axis=1)
            total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-6)
            centre_a, centre_b = (
                (weight * z).sum(axis=1, keepdims=True) / total for z in (points_a, points_b)
            )
            cross = weight * (points_a - centre_a) * np.conj(points_b - centre_b)
            cross = cross.sum(axis=1, keepdims=True)
            length = np.abs(cross)
            r = np.where(length > 1e-6, cross / np.maximum(length, 1e-6), r)
            s = centre_a - r * centre_b
        shift[batch], turn[batch] = s[:, 0], np.angle(r[:, 0])
    return shift, turn


def _weight(offset: NDArray[np.complex64], sigma: float) -> NDArray[np.float32]:
    exponent = (offset.real * offset.real + offset.imag * offset.imag) * np.float32(0.5 / sigma**2)
    return np.exp(-np.minimum(exponent, np.float32(30.0)))


def _cells(z: NDArray[Any]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Flat fine cells of points, those outside at the border, and whether they lie inside."""
    side = 2 * SIDE
    x = ((z.real + REACH_M) / FINE_M).astype(np.int32)
    y = ((z.imag + REACH_M) / FINE_M).astype(np.int32)
    inside = (np.abs(z.real) < REACH_M) & (np.abs(z.imag) < REACH_M)
    inside &= (x < side) & (y < side)  # within the rim by rounding
    return np.where(inside, y * side + x, 0), inside


def _offset_to_wall(
    nearest_wall: NDArray[np.uint16], view: IntArray, z: NDArray[np.complex64]
) -> tuple[NDArray[np.complex64], NDArray[np.bool_]]:
    """Offsets from points z to the nearest wall of their views, and whether they lie inside."""
    cell, inside = _cells(z)
    wall_cell = np.take(nearest_wall.reshape(-1), cell + view[:, None] * nearest_wall[0].size)
    return _CELL_CENTRES[wall_cell] - z, inside


def _count_agreement(pairs: _Pairs, shift: ComplexArray, turn: FloatArray) -> Registered:
    """The registrations at the given shifts and turns, with their counts and information."""
    a, b, *_ = pairs
    agree, contradict = np.zeros(len(shift), np.int64), np.zeros(len(shift), np.int64)
    information = np.zeros((len(shift), 3, 3))
    rotation = np.exp(1j * turn)
    for batch, i, j in pairs.batches():
        s, r = shift[batch, None], rotation[batch, None]
        wall_b_in_a, wall_a_in_b = r * b.points[j] + s, np.conj(r) * (a.points[i] - s)
        kind_of_b = _kinds(a.kind, i, wall_b_in_a, b.is_point[j])
        kind_of_a = _kinds(b.kind, j, wall_a_in_b, a.is_point[i])
        for kind, counts in ((AGREES, agree), (CONTRADICTS, contradict)):
            counts[batch] = (kind_of_b == kind).sum(axis=1) + (kind_of_a == kind).sum(axis=1)
        normal_in_a, agrees = r * r * b.normal[j], kind_of_b == AGREES
        information[batch] = _information(normal_in_a, wall_b_in_a - s, agrees)
    transform = np.stack([shift.real, shift.imag, turn], axis=1)
    return Registered(transform, agree, contradict, information)


def _kinds(
    kind: NDArray[np.uint8], view: IntArray, z: NDArray[Any], is_point: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Kinds of wall cells at points z of their views; 0 for padding and outside of the views."""
    cell, inside = _cells(z)
    looked_up = np.take(kind.reshape(-1), cell + view[:, None] * kind[0].size)
    return np.where(inside & is_point, looked_up, np.uint8(SILENT))


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """The wall cells of two views laid over each other.

    xy: (k, 2) their centres [m], in the frame of the first view; of_second: (k,) whether each is of
    the second view; kind: (k,) `SILENT`, `AGREES` or `CONTRADICTS`.
    """

    xy: FloatArray
    of_second: NDArray[np.bool_]
    kind: NDArray[np.uint8]


def compare(a: ViewIndex, b: ViewIndex, rows: tuple[int, int], transform: FloatArray) -> Compared:
    """The wall cells of views `rows` of a and b, laid over each other by a transform (3,)."""
    i, j = rows
    shift, rotation = complex(transform[0], transform[1]), np.exp(1j * transform[2])
    wall_a, wall_b = a.points[i, a.is_point[i]], rotation * b.points[j, b.is_point[j]] + shift
    wall_a_in_b = np.conj(rotation) * (wall_a - shift)
    kinds = [
        _kinds(kind, np.array([row]), z[None], np.ones((1, len(z)), bool))[0]
        for kind, row, z in ((b.kind, j, wall_a_in_b), (a.kind, i, wall_b))
    ]
    points = np.concatenate([wall_a, wall_b])
    of_second = np.arange(len(points)) >= len(wall_a)
    return Compared(np.column_stack([points.real, points.imag]), of_second, np.concatenate(kinds))


SIGMA_M = 0.1
"""1 sigma of the distance of a wall cell: half a cell."""
CORRELATED = 10
"""Wall cells with one common error: 2 m of wall."""


def _information(normal: ComplexArray, lever: ComplexArray, agree: NDArray[np.bool_]) -> FloatArray:
    """(k, 3, 3) information of the transform from the points that agree. A point fixes the distance
    across a straight wall, and both coordinates at a corner.

    normal: (k, m) as in `ViewIndex`; lever: (k, m) offsets of the points from the origin of b.
    """
    straight = np.abs(normal)
    along = np.where(straight > 0, normal / np.maximum(straight, 1e-12), 1.0)
    # nnᵀ = (1 + cos 2φ, sin 2φ; sin 2φ, 1 - cos 2φ) / 2 for straight walls, half of 1 for others.
    half_cos, half_sin = 0.5 * straight * along.real, 0.5 * straight * along.imag
    weight = agree / (CORRELATED * SIGMA_M**2)
    xx, yy, xy = weight * (0.5 + half_cos), weight * (0.5 - half_cos), weight * half_sin
    # A turn by θ moves the point by θ (-y, x).
    turn_x, turn_y = -lever.imag, lever.real
    information = np.zeros((len(normal), 3, 3))
    information[:, 0, 0], information[:, 1, 1] = xx.sum(axis=1), yy.sum(axis=1)
    information[:, 0, 1] = information[:, 1, 0] = xy.sum(axis=1)
    information[:, 0, 2] = information[:, 2, 0] = (xx * turn_x + xy * turn_y).sum(axis=1)
    information[:, 1, 2] = information[:, 2, 1] = (xy * turn_x + yy * turn_y).sum(axis=1)
    information[:, 2, 2] = (
        turn_x * (xx * turn_x + xy * turn_y) + turn_y * (xy * turn_x + yy * turn_y)
    ).sum(axis=1)
    return information


@dataclass(frozen=True, slots=True)
class ViewNull:
    """Distributions of z over pairs of different places and over pairs of one place.

    middle, spread: median and standard deviation of different places, the latter by the upper tail;
    same: median of one place.
    """

    middle: float
    spread: float
    same: float

    @classmethod
    def of(cls, different: FloatArray, same: FloatArray) -> ViewNull:
        """Estimated from z of pairs of certainly different places, and of revisits, if any."""
        middle, spread = 0.7, 0.62  # medians over the buildings of the study
        if len(different) >= LEAST_NULL:
            middle = float(np.median(different))
            tail = float(np.quantile(different, 0.99)) - middle
            spread = max(tail / 2.33, LEAST_SPREAD)
        typical = float(np.median(same)) if len(same) >= LEAST_SAME else 0.0
        return cls(middle, spread, min(max(typical, SAME_Z[0]), SAME_Z[1]))

    def odds(self, z: FloatArray, level: FloatArray | float = -np.inf) -> FloatArray:
        """(k,) log likelihood ratio [nats] of one place against two, bounded.

        ln [.95 N(z; same) + .05 N(z; m)] - ln [.998 N(z; m) + .002 N(z; same)], with m the median
        of different places or, if higher, the z that the two places reach with different places,
        `level` (k,) (cohort normalisation).
        """
        middle = np.maximum(self.middle, level)
        # z beyond the two medians counts as the nearer one.
        z = np.clip(z, np.minimum(middle, self.same), self.same)
        same, different = _normal(z, self.same, SAME_SPREAD), _normal(z, middle, self.spread)
        blurred = _normal(z, middle, 1.2 * self.spread)
        odds = np.log((1 - MISSED) * same + MISSED * blurred)
        odds -= np.log((1 - CHANCE) * different + CHANCE * same)
        return np.asarray(np.clip(odds, -LEAST_BITS * BIT, MOST_BITS * BIT))


LEAST_NULL, LEAST_SAME = 30, 5
"""Least number of pairs to estimate either distribution."""
LEAST_SPREAD = 0.35
SAME_SPREAD = 0.6
SAME_Z = (3.95, 5.5)
"""Range of the typical z of revisits: medians of five real buildings."""
MISSED, CHANCE = 0.05, 0.002
"""Share of revisits that look like another place (doors, people), and of other places that look
like the same one."""
LEAST_BITS, MOST_BITS = 5.0, 9.0
"""Bounds of the evidence of one pair of views, against one place and for it."""


def _normal(z: FloatArray, mean: FloatArray | float, sigma: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * ((z - mean) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)))
