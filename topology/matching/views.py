"""Registration of views, and what their agreement tells.

Two views of one place, laid over each other, agree: the walls of each lie on walls of the other, or
where the other did not look. Walls of one in the free space of the other contradict it (as by
Millane et al., Free-Space Features, arXiv:1908.01863). The log of their ratio,

    z = ln (agreeing + 1) / (contradicting + 1),

both ways, is compared with what other places of the same maps reach (`ViewNull`).
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
from ..views import CELL_M, FREE, REACH_M, SIDE, WALL, Views
from .likelihood import BIT

FINE_M = CELL_M / 2
"""Resolution of the fields that points are looked up in."""
COARSE_M = 2 * CELL_M
"""Resolution of the correlation that finds starts."""
PADDED = 64
"""Coarse cells along the side of a view and of its shifts, which do not wrap around up to 9 m."""
TURN_RAD = np.pi / 36
"""Raster of turns that are tried: a wall at the rim of a view moves by less than two coarse cells
from one to the next."""
AGREE_M, CONTRADICT_M = 0.2, 0.32
"""A wall agrees as near to a wall of the other view, and contradicts as far from it, in free
space: in between it says nothing (study of five buildings, cells of 0.1 and 0.2 m)."""
STARTS = 2
"""Best coarse shifts that are refined."""

_AGREES, _CONTRADICTS = 1, 2
"""Kinds of fine cells; 0 says nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """`k` pairs of views, laid over each other.

    transform: (k, 3) of the second view's frame in the first one's; agree, contradict: (k,) numbers
    of wall cells of either that agree and contradict; information: (k, 3, 3) of the transform, in
    the axes of the first view: hardly any along bare corridors.
    """

    transform: FloatArray
    agree: IntArray
    contradict: IntArray
    information: FloatArray

    def some(self, rows: IntArray | slice) -> Registered:
        """These pairs."""
        return Registered(
            self.transform[rows], self.agree[rows], self.contradict[rows], self.information[rows]
        )

    @property
    def z(self) -> FloatArray:
        """(k,) log ratio of agreement to contradiction."""
        return np.asarray(np.log((self.agree + 1.0) / (self.contradict + 1.0)))

    @property
    def detail(self) -> FloatArray:
        """(k,) information of the shift in the direction in which the walls that agree tell least
        [1/m²]: none along a bare corridor."""
        return np.asarray(np.linalg.eigvalsh(self.information[:, :2, :2])[:, 0])


@dataclass(frozen=True, eq=False)
class ViewIndex:
    """Views prepared for registration.

    points: (n, m) wall cells as complex numbers [m], padded by zeros; normal: (n, m) directions
    across the walls as unit numbers, squared, times how straight the wall is there; there: (n, m)
    whether there is a point; nearest: (n, f, f) the wall nearest to each fine cell, as a row of
    `_PLACES`; kind: (n, f, f) what a wall of another view tells here; near: (n, c, c) how well a
    wall would fit here, in coarse cells.
    """

    points: NDArray[np.complex64]
    normal: NDArray[np.complex64]
    there: NDArray[np.bool_]
    nearest: NDArray[np.uint16]
    kind: NDArray[np.uint8]
    near: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of(cls, views: Views) -> ViewIndex:
        """Prepare views. About 3 ms and 100 kB each."""
        n, fine = len(views), 2 * SIDE
        count = (views.cells == WALL).sum(axis=(1, 2))
        most = int(count.max(initial=0))
        points = np.zeros((n, most), np.complex64)
        normal = np.zeros((n, most), np.complex64)
        nearest = np.full((n, fine, fine), fine * fine, np.uint16)
        kind = np.zeros((n, fine, fine), np.uint8)
        coarse = SIDE // 2
        near = np.zeros((n, coarse, coarse), np.float32)
        across = _normals(views.cells == WALL)
        for k, cells in enumerate(views.cells):
            row, column = np.nonzero(cells == WALL)
            points[k, : len(row)] = _metres(column, CELL_M) + 1j * _metres(row, CELL_M)
            if not len(row):
                continue
            normal[k, : len(row)] = across[k, row, column]
            wide = cells.repeat(2, axis=0).repeat(2, axis=1)
            away, (y, x) = ndimage.distance_transform_edt(wide != WALL, return_indices=True)
            nearest[k] = y * fine + x
            away *= FINE_M
            clear = wide == FREE
            kind[k] = np.where(
                away <= AGREE_M + 1e-9,
                _AGREES,
                np.where(clear & (away > CONTRADICT_M), _CONTRADICTS, 0),
            )
            fit = 1.6 * np.exp(-0.5 * (away / 0.26) ** 2) - 0.6
            fit = np.where(clear | (wide == WALL), fit, np.where(away > 0.5, 0, np.maximum(fit, 0)))
            near[k] = (
                fit.reshape(coarse, 4, fine).max(axis=1).reshape(coarse, coarse, 4).max(axis=2)
            )
        return cls(points, normal, np.arange(most) < count[:, None], nearest, kind, near)

    @cached_property
    def spectrum(self) -> NDArray[np.complex64]:
        """(n, PADDED, PADDED / 2 + 1) Fourier transforms of `near`."""
        return np.asarray(fft.rfft2(self.near, (PADDED, PADDED)))

    def turned_spectra(self, row: int, turns: FloatArray) -> NDArray[np.complex64]:
        """(t, PADDED, PADDED / 2 + 1) conjugate transforms of the walls of one view turned by each
        of `turns` (t,) [rad]."""
        points = self.points[row, self.there[row]]
        turned = np.exp(1j * turns)[:, None] * points
        x = ((turned.real + REACH_M) / COARSE_M).astype(np.int64)
        y = ((turned.imag + REACH_M) / COARSE_M).astype(np.int64)
        last = SIDE // 2 - 1
        image = np.zeros((len(turns), PADDED, PADDED), np.float32)
        image[np.arange(len(turns))[:, None], np.clip(y, 0, last), np.clip(x, 0, last)] = 1.0
        return np.asarray(np.conj(fft.rfft2(image)))


def _metres(cell: IntArray, size_m: float) -> FloatArray:
    return np.asarray((cell + 0.5) * size_m - REACH_M)


def _places() -> NDArray[np.complex64]:
    """The middles of all fine cells [m], and of none, 0."""
    along = _metres(np.arange(2 * SIDE), FINE_M)
    return np.append(along + 1j * along[:, None], 0.0).astype(np.complex64)


_PLACES = _places()


def _normals(wall: NDArray[np.bool_]) -> ComplexArray:
    """(n, s, s) squared direction across the walls of each view at each cell, as a complex number
    as long as the wall is straight there, 0 to 1: the structure tensor of the walls (Förstner,
    Gülch 1987)."""
    soft = ndimage.gaussian_filter(wall.astype(np.float64), (0.0, 1.0, 1.0))
    dy, dx = np.gradient(soft, axis=(1, 2))
    double = (dx + 1j * dy) ** 2
    parts = (double.real, double.imag, np.abs(double))
    real, imag, total = (ndimage.gaussian_filter(part, (0.0, 1.5, 1.5)) for part in parts)
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
    """Lay views `second` (k,) of b over views `first` (k,) of a, each by the best of its turns.

    turns: (k, t) turns from b to a that are tried [rad]; reach_m: largest shift of the place, to
    either side and up and down, from `centre` (k, 2) [m] (zero by default).
    """
    pairs = _Pairs(a, b, first, second)
    shift, turn, _ = _starts(pairs, turns, reach_m, centre)
    several = pairs.repeated(STARTS)
    z, angle = _refined(several, shift.reshape(-1), turn.reshape(-1))
    found = _tallied(several, z, angle)
    score = (found.z * np.sqrt(found.agree + found.contradict + 1.0)).reshape(-1, STARTS)
    best = np.arange(len(first)) * STARTS + np.argmax(found.z.reshape(-1, STARTS) + 1e-6 * score, 1)
    return found.some(best)


def coarse_fit(
    index: ViewIndex, first: IntArray, second: IntArray, turns: FloatArray, reach_m: float
) -> FloatArray:
    """(k,) mean fit, at most 1, of the walls of views `second` (k,) to views `first` (k,), at the
    best of the turns (k, t) and of the shifts within `reach_m`: a tenth of the work of `register`,
    to choose what is registered."""
    return _starts(_Pairs(index, index, first, second), turns, reach_m, None)[2]


class _Pairs(NamedTuple):
    """Views `first` (k,) of a and `second` (k,) of b."""

    a: ViewIndex
    b: ViewIndex
    first: IntArray
    second: IntArray

    def repeated(self, times: int) -> _Pairs:
        return _Pairs(self.a, self.b, self.first.repeat(times), self.second.repeat(times))

    def parts(self) -> Iterator[tuple[slice, IntArray, IntArray]]:
        """The pairs in parts that fit the cache."""
        for begin in range(0, len(self.first), _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            yield some, self.first[some], self.second[some]


def _starts(
    pairs: _Pairs, turns: FloatArray, reach_m: float, centre: FloatArray | None
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """(k, STARTS) each: shifts [m] and turns [rad] with the best coarse correlation, of different
    turns; (k,) the best correlation, as a mean over the walls of the second view."""
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
    for rows in np.split(order, np.flatnonzero(np.diff(second[order])) + 1):
        if not len(rows):
            continue
        raster, which = np.unique(number[rows], return_inverse=True)
        spectra = b.turned_spectra(int(second[rows[0]]), np.asarray(raster * TURN_RAD))
        which = which.reshape(len(rows), t)
        for part in np.array_split(np.arange(len(rows)), -(-len(rows) * t // 2048)):
            own = rows[part]
            product = a.spectrum[first[own], None] * spectra[which[part]]
            score = fft.irfft2(product, (PADDED, PADDED), overwrite_x=True)
            y = (middle[own, 1, None] + window) % PADDED
            x = (middle[own, 0, None] + window) % PADDED
            i, j = np.arange(len(own))[:, None, None, None], np.arange(t)[:, None, None]
            near = score[i, j, y[:, None, :, None], x[:, None, None, :]].reshape(len(own), t, -1)
            at, most = near.argmax(axis=2), near.max(axis=2)
            fit[own] = most.max(axis=1) / max(int(spectra[0, 0, 0].real), 1)
            for s in range(STARTS):
                best = most.argmax(axis=1)
                row = np.arange(len(own))
                cell = at[row, best]
                dy, dx = window[cell // len(window)], window[cell % len(window)]
                shift[own, s] = ((middle[own, 0] + dx) + 1j * (middle[own, 1] + dy)) * COARSE_M
                turn[own, s] = number[own, best] * TURN_RAD
                most[row, best] = -np.inf
    return shift, turn, fit


SIGMAS_M = (0.4, 0.4, 0.3, 0.3, 0.2, 0.2, 0.2, 0.13, 0.13, 0.13)
"""Width of the weights of each iteration of the refinement: from a coarse cell to the noise. With
half as many iterations errors are 1.5 times as large, with 15 a tenth less."""
LEAST_POINTS = 120
"""Points of either view that are refined with, if it has more, until the last iterations."""
_AT_ONCE = 256
"""Pairs that are refined at once, to fit the cache."""


def _refined(
    pairs: _Pairs, shift: ComplexArray, turn: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    """Shifts and turns after iterated closest points, both ways, with weights that fall off with
    the distance (Gaussian)."""
    a, b, *_ = pairs
    for some, i, j in pairs.parts():
        s, r = shift[some].astype(np.complex64), np.exp(1j * turn[some]).astype(np.complex64)
        for k, sigma in enumerate(SIGMAS_M):
            last = k >= len(SIGMAS_M) - 2
            every = [1 if last else max(m.points.shape[1] // LEAST_POINTS, 1) for m in (a, b)]
            pa, wa = a.points[i, :: every[0]], a.there[i, :: every[0]]
            pb, wb = b.points[j, :: every[1]], b.there[j, :: every[1]]
            there = r[:, None] * pb + s[:, None]
            off, known_a = _looked_up(a.nearest, i, there)
            back = np.conj(r)[:, None] * (pa - s[:, None])
            gap, known_b = _looked_up(b.nearest, j, back)
            # Pairs of points: of b's walls with a's nearest, and of a's walls with b's nearest.
            x = np.concatenate([there + off, pa], axis=1)
            y = np.concatenate([pb, back + gap], axis=1)
            weight = np.concatenate(
                [(wb & known_a) * _weight(off, sigma), (wa & known_b) * _weight(gap, sigma)], axis=1
            )
            total = np.maximum(weight.sum(axis=1), 1e-6)
            mx, my = (weight * x).sum(axis=1) / total, (weight * y).sum(axis=1) / total
            cross = (weight * (x - mx[:, None]) * np.conj(y - my[:, None])).sum(axis=1)
            size = np.abs(cross)
            r = np.where(size > 1e-6, cross / np.maximum(size, 1e-6), r)
            s = mx - r * my
        shift[some], turn[some] = s, np.angle(r)
    return shift, turn


def _weight(off: NDArray[np.complex64], sigma: float) -> NDArray[np.float32]:
    q = (off.real * off.real + off.imag * off.imag) * np.float32(0.5 / sigma**2)
    return np.exp(-np.minimum(q, np.float32(30.0)))


def _cells(z: NDArray[Any]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Flat fine cells of points, those outside at the border, and whether they lie inside."""
    side = 2 * SIDE
    x = ((z.real + REACH_M) / FINE_M).astype(np.int32)
    y = ((z.imag + REACH_M) / FINE_M).astype(np.int32)
    inside = (np.abs(z.real) < REACH_M) & (np.abs(z.imag) < REACH_M)
    inside &= (x < side) & (y < side)  # within the rim by rounding
    return np.where(inside, y * side + x, 0), inside


def _looked_up(
    field: NDArray[np.uint16], row: IntArray, z: NDArray[np.complex64]
) -> tuple[NDArray[np.complex64], NDArray[np.bool_]]:
    """Shift from points to the nearest wall, and whether they lie inside of the view."""
    cell, inside = _cells(z)
    off = _PLACES[np.take(field.reshape(-1), cell + row[:, None] * field[0].size)] - z
    return off, inside


def _tallied(pairs: _Pairs, shift: ComplexArray, turn: FloatArray) -> Registered:
    """What agrees and contradicts at these shifts and turns."""
    a, b, *_ = pairs
    agree, contradict = np.zeros(len(shift), np.int64), np.zeros(len(shift), np.int64)
    information = np.zeros((len(shift), 3, 3))
    r = np.exp(1j * turn)
    for some, i, j in pairs.parts():
        s, u = shift[some, None], r[some, None]
        there, back = u * b.points[j] + s, np.conj(u) * (a.points[i] - s)
        of_b = _kinds(a.kind, i, there, b.there[j])
        of_a = _kinds(b.kind, j, back, a.there[i])
        for kind, out in ((_AGREES, agree), (_CONTRADICTS, contradict)):
            out[some] = (of_b == kind).sum(axis=1) + (of_a == kind).sum(axis=1)
        information[some] = _information(u * u * b.normal[j], there - s, of_b == _AGREES)
    transform = np.stack([shift.real, shift.imag, turn], axis=1)
    return Registered(transform, agree, contradict, information)


def _kinds(
    kind: NDArray[np.uint8], row: IntArray, z: NDArray[Any], there: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    cell, inside = _cells(z)
    found = np.take(kind.reshape(-1), cell + row[:, None] * kind[0].size)
    return np.where(inside & there, found, np.uint8(0))


SILENT, AGREES, CONTRADICTS = 0, _AGREES, _CONTRADICTS
"""What a wall cell of one view tells of another view."""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """The wall cells of two views laid over each other.

    xy: (k, 2) their middles [m], in the frame of the first view; of_second: (k,) of which of the
    two; kind: (k,) `SILENT`, `AGREES` or `CONTRADICTS`.
    """

    xy: FloatArray
    of_second: NDArray[np.bool_]
    kind: NDArray[np.uint8]


def compared(a: ViewIndex, b: ViewIndex, rows: tuple[int, int], transform: FloatArray) -> Compared:
    """One view of a and one of b, `rows`, at a registration (3,)."""
    i, j = rows
    shift, turn = complex(transform[0], transform[1]), np.exp(1j * transform[2])
    own, there = a.points[i, a.there[i]], turn * b.points[j, b.there[j]] + shift
    back = np.conj(turn) * (own - shift)
    told = [
        _kinds(kind, np.array([row]), z[None], np.ones((1, len(z)), bool))[0]
        for kind, row, z in ((b.kind, j, back), (a.kind, i, there))
    ]
    points = np.concatenate([own, there])
    of_second = np.arange(len(points)) >= len(own)
    return Compared(np.column_stack([points.real, points.imag]), of_second, np.concatenate(told))


SIGMA_M = 0.1
"""1 sigma of a wall's distance: half a cell."""
CORRELATED = 10
"""Wall cells that err together, 2 m of wall."""


def _information(normal: ComplexArray, lever: ComplexArray, agree: NDArray[np.bool_]) -> FloatArray:
    """(k, 3, 3) of the transform, from agreeing points at `lever` (k, m) from the origin of b and
    the squared directions `normal` across their walls: a point fixes the distance across its wall,
    where the wall is not straight in both directions."""
    straight = np.abs(normal)
    along = np.where(straight > 0, normal / np.maximum(straight, 1e-12), 1.0)
    # nnᵀ = (1 + cos 2φ, sin 2φ; sin 2φ, 1 - cos 2φ) / 2 for straight walls, half of 1 for others.
    c, s = 0.5 * straight * along.real, 0.5 * straight * along.imag
    weight = agree / (CORRELATED * SIGMA_M**2)
    xx, yy, xy = weight * (0.5 + c), weight * (0.5 - c), weight * s
    # A turn by θ moves the point by θ (-y, x).
    u, v = -lever.imag, lever.real
    out = np.zeros((len(normal), 3, 3))
    out[:, 0, 0], out[:, 1, 1] = xx.sum(axis=1), yy.sum(axis=1)
    out[:, 0, 1] = out[:, 1, 0] = xy.sum(axis=1)
    out[:, 0, 2] = out[:, 2, 0] = (xx * u + xy * v).sum(axis=1)
    out[:, 1, 2] = out[:, 2, 1] = (xy * u + yy * v).sum(axis=1)
    out[:, 2, 2] = (u * (xx * u + xy * v) + v * (xy * u + yy * v)).sum(axis=1)
    return out


@dataclass(frozen=True, slots=True)
class ViewNull:
    """Distribution of z over pairs of different places, and over pairs of one place.

    middle, spread: median and standard deviation of the former, by its upper tail; same: typical z
    of the latter.
    """

    middle: float
    spread: float
    same: float

    @classmethod
    def of(cls, different: FloatArray, same: FloatArray) -> ViewNull:
        """From z of pairs of places that are certainly different, and of revisits, if any."""
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
        of different places, or the `level` (k,) that the places of a pair are known to reach with
        different ones, if it is higher (cohort normalisation).
        """
        middle = np.maximum(self.middle, level)
        # Better than usual counts as usual, and worse than other places do as those.
        z = np.clip(z, np.minimum(middle, self.same), self.same)
        one, two = _normal(z, self.same, SAME_SPREAD), _normal(z, middle, self.spread)
        blurred = _normal(z, middle, 1.2 * self.spread)
        odds = np.log((1 - MISSED) * one + MISSED * blurred)
        odds -= np.log((1 - CHANCE) * two + CHANCE * one)
        return np.asarray(np.clip(odds, -LEAST_BITS * BIT, MOST_BITS * BIT))


LEAST_NULL, LEAST_SAME = 30, 5
"""Fewer pairs tell nothing of a distribution."""
LEAST_SPREAD = 0.35
SAME_SPREAD = 0.6
SAME_Z = (3.95, 5.5)
"""Range of the typical z of revisits: medians of five real buildings."""
MISSED, CHANCE = 0.05, 0.002
"""Share of revisits that look like another place (doors, people), and of other places that look
like the same one."""
LEAST_BITS, MOST_BITS = 5.0, 9.0
"""Bounds of what one pair of views tells for and against."""


def _normal(z: FloatArray, mean: FloatArray | float, sigma: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * ((z - mean) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)))
