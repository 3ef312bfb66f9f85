"""Candidate placements from views: the walls of one map found in the other as pictures.

Stretches of way of one map are laid over the whole of the other, in the few turns that lay walls
along walls, by cross-correlation (FFT). Places of neighbouring stretches that agree are summed up,
so that a map that drift bends is found as well.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.spatial import cKDTree

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.matching.views import ViewIndex
from ...topology.se2 import wrap
from ...topology.views import CELL_M, FREE, REACH_M, Views
from .settings import MATCH

PIXEL_M = 0.4
"""Side of a pixel: walls that drift and turns have shifted by half of it still meet."""
STRETCH_M, STEP_M = 24.0, 12.0
"""Length of the stretches, and from one to the next. Of 19 pairs of five real and simulated
buildings whose true placement is found at all, none was lost with 16 or 36 m, and more led."""
MOST_STRETCHES = 16
"""More would cost time and tell little that is new."""
MOST_PIXELS = 512
"""Side of the squares, 205 m, that larger maps are cut into: of runs through tunnels and streets
most squares are empty."""
OVERLAP_M = STRETCH_M + 4 * REACH_M
"""By so much squares overlap: a stretch whose middle lies in one lies in it as a whole."""
PEAKS = 3
"""Best places of a stretch and a turn that are kept."""
CONTRADICTS = 4.0
"""Weight of a wall in the free space of the other map, against one that agrees. With 1 the true
placement leads in 6 of 16 pairs of real runs, with 2 in 7, with 3, 4 and 8 in 11."""
ANGLES = 90
"""Directions of walls that are told apart within a quarter turn: 1°."""
MOST_POINTS = 3000
"""Wall cells that are projected: a sample of larger maps tells the same."""
LEAST_WALLS = 30
"""A stretch with fewer wall cells shows nothing."""
MOST_PLACEMENTS = 8
"""Placements that are registered."""
SAME_M, SAME_PER_M, SAME_RAD = 3 * PIXEL_M, 0.05, 0.2
"""Stretches that are placed alike within so much, and per metre between them, support each other:
3° of drift."""

KEPT = 256
"""Maps of which a process remembers what else it has worked out: as many as it has at hand."""
KEPT_VIEWS = 3000
"""Views of pictures that are kept, 130 kB each: a tile of tasks has 16 maps a side of some 100
views, and the next tile shares one of the sides."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The views of a map, as points in its frame.

    walls, free: of each view, x + iy [m].
    """

    views: Views
    index: ViewIndex
    walls: tuple[ComplexArray, ...]
    free: tuple[ComplexArray, ...]

    @property
    def pose(self) -> FloatArray:
        """(n, 3) poses of the views."""
        return self.views.pose

    @cached_property
    def place(self) -> ComplexArray:
        """(n,) places of the views."""
        return np.asarray(self.pose[:, 0] + 1j * self.pose[:, 1])

    @cached_property
    def nearest(self) -> cKDTree:
        """For nearest-neighbour search among the places."""
        return cKDTree(self.pose[:, :2])

    @cached_property
    def directions(self) -> FloatArray:
        """Directions of all walls (`directions`)."""
        return directions(np.concatenate(self.walls))

    @cached_property
    def local_directions(self) -> FloatArray:
        """Sum of the directions of the stretches: in `directions` a few long walls outweigh the
        many that single stretches see."""
        return np.asarray(sum((part.directions for part in self.stretches), np.zeros(ANGLES)))

    @cached_property
    def turn(self) -> float:
        """What turns the map so that its walls lie along the axes [rad]."""
        return -float(np.argmax(self.directions)) * np.pi / 2 / ANGLES

    @cached_property
    def squares(self) -> list[Square]:
        """The squares that the map is drawn on: one, or as many as have walls."""
        walls = np.exp(1j * self.turn) * np.concatenate(self.walls)
        low = complex(walls.real.min(), walls.imag.min())
        high = complex(walls.real.max(), walls.imag.max())
        wide = max((high - low).real, (high - low).imag)
        size = int((wide + STRETCH_M + 2 * REACH_M) / PIXEL_M) + 4
        if size <= MOST_PIXELS:
            size = int(fft.next_fast_len(size, real=True))
            return [Square((low + high) / 2 * np.exp(-1j * self.turn), size, size)]
        inner = MOST_PIXELS - int(OVERLAP_M / PIXEL_M)
        step = inner * PIXEL_M
        # The middle of a stretch lies up to half of it aside of the walls of this map.
        around = np.add.outer([-1, 0, 1], np.multiply([-1, 0, 1], 1j)).ravel() * STRETCH_M / 2
        at = ((walls[:, None] - low + around) / step).ravel()
        cells = np.unique(np.column_stack([np.floor(at.real), np.floor(at.imag)]), axis=0)
        middles = low + (cells @ [1, 1j] + 0.5 + 0.5j) * step
        return [Square(z, MOST_PIXELS, inner) for z in middles * np.exp(-1j * self.turn)]

    @property
    def tiles(self) -> Iterable[Tile]:
        """The map drawn on its squares. Of several, which may be too many to keep, each is drawn
        when it is taken."""
        return (self._whole,) if len(self.squares) == 1 else map(self._tile, self.squares)

    @cached_property
    def _whole(self) -> Tile:
        return self._tile(self.squares[0])

    def _tile(self, square: Square) -> Tile:
        reach = square.size * PIXEL_M + REACH_M  # more than half of the diagonal
        rows = np.flatnonzero(np.abs(self.place - square.middle) < reach)
        walls, free = (
            np.concatenate([z[k] for k in rows] or [z[0][:0]]) for z in (self.walls, self.free)
        )
        drawn = _drawn(walls, free, self.turn, square.middle, square.size)
        spectra = tuple(
            (fft.rfft2(np.rot90(drawn[0], quarter)), fft.rfft2(np.rot90(drawn[1], quarter)))
            for quarter in range(4)
        )
        return Tile(square, spectra)

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """Its stretches of way."""
        return tuple(self._stretches())

    def _stretches(self) -> Iterator[Stretch]:
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self.place)))])
        starts = np.arange(0.0, max(way[-1] - STRETCH_M, 0.0) + STEP_M, STEP_M)
        few = np.linspace(0, len(starts) - 1, min(len(starts), MOST_STRETCHES))
        for start in starts[np.unique(np.rint(few).astype(np.int64))].tolist():
            rows = np.flatnonzero((way >= start) & (way <= start + STRETCH_M))
            # A jump from one view to the next tears a stretch apart.
            if not len(rows):
                continue
            rows = rows[np.abs(self.place[rows] - np.median(self.place[rows])) < STRETCH_M / 2]
            walls = np.concatenate([self.walls[k] for k in rows] or [np.zeros(0, np.complex128)])
            if len(walls) >= LEAST_WALLS:
                free = np.concatenate([self.free[k] for k in rows])
                middle = complex(self.place[rows].mean())
                yield Stretch(walls, free, middle, directions(walls))


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Walls and free space along a stretch of way around its middle, x + iy [m], and the directions
    of its walls."""

    walls: ComplexArray
    free: ComplexArray
    middle: complex
    directions: FloatArray

    @property
    def reach_m(self) -> float:
        """The distance of the farthest from the middle [m]."""
        return max(float(np.abs(z - self.middle).max(initial=0)) for z in (self.walls, self.free))


_pictures: OrderedDict[Views, Picture] = OrderedDict()


def pictured(views: Views) -> Picture:
    """The picture of a map's views; those used last are kept (`KEPT_VIEWS`, but two at least)."""
    picture = _pictures.pop(views) if views in _pictures else _pictured(views)
    _pictures[views] = picture
    while len(_pictures) > 2 and sum(map(len, _pictures)) > KEPT_VIEWS:
        _pictures.popitem(last=False)
    return picture


def _pictured(views: Views) -> Picture:
    index = ViewIndex.of(views)
    place = views.pose[:, 0] + 1j * views.pose[:, 1]
    unit = np.exp(1j * views.pose[:, 2])
    walls, free = [], []
    for k, cells in enumerate(views.cells):
        walls.append(place[k] + unit[k] * index.points[k, index.there[k]])
        y, x = np.nonzero(cells[::2, ::2] == FREE)  # every second one, a pixel apart
        off = (2 * x + 0.5) * CELL_M - REACH_M + 1j * ((2 * y + 0.5) * CELL_M - REACH_M)
        free.append(place[k] + unit[k] * off)
    return Picture(views, index, tuple(walls), tuple(free))


def directions(walls: ComplexArray) -> FloatArray:
    """(ANGLES,) how clearly walls lie along and across each direction of a quarter turn.

    Walls are projected on both axes: where these lie along them, few strips of them, as wide as a
    cell, hold most cells. 0 for none; means of normals, in comparison, err by 6° where cells lie
    along other axes.
    """
    z = walls[:: -(-len(walls) // MOST_POINTS)] if len(walls) else walls
    if not len(z):
        return np.zeros(ANGLES)
    turned = np.exp(-0.5j * np.pi * np.arange(ANGLES) / ANGLES)[:, None] * (z - z.mean())
    strips = int(2 * np.abs(z - z.mean()).max() / CELL_M) + 4
    out = np.zeros(ANGLES)
    for across in (turned.real, turned.imag):
        strip = (across / CELL_M + strips / 2).astype(np.int64)
        strip += strips * np.arange(ANGLES)[:, None]
        held = np.bincount(strip.reshape(-1), minlength=strips * ANGLES).reshape(ANGLES, strips)
        out += (held.astype(np.float64) ** 2).sum(axis=1)
    return np.maximum(out / np.median(out) - 1.0, 0.0)


Spectra = tuple[NDArray[np.complex64], NDArray[np.complex64]]
"""Fourier transforms of a picture of the walls, and of how well a wall of another map fits."""


@dataclass(frozen=True, slots=True)
class Square:
    """A square of size × size pixels around `middle`, x + iy [m]. Stretches are looked for whose
    middles lie within the `inner` × `inner` pixels around its own."""

    middle: complex
    size: int
    inner: int


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A map drawn on a square, turned by `Picture.turn`, and from there by 0 to 3 quarter turns,
    clockwise in the map's frame."""

    square: Square
    quarters: tuple[Spectra, ...]


def _drawn(
    walls: ComplexArray, free: ComplexArray, turn: float, middle: complex, size: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(size, size) pictures of walls and free space, x + iy [m], turned [rad] about a middle: the
    walls, and how well a wall of another map fits."""
    wall, clear = (_marked(z, turn, middle, size) for z in (walls, free))
    near = np.minimum(2.5 * ndimage.gaussian_filter(wall, 0.7), 1.0)
    against = clear * (ndimage.maximum_filter(wall, 3) == 0)
    return wall, np.maximum(wall, near) - np.float32(CONTRADICTS) * against


def _marked(z: ComplexArray, turn: float, middle: complex, size: int) -> NDArray[np.float32]:
    out = np.zeros((size, size), np.float32)
    at = (z - middle) * np.exp(1j * turn) / PIXEL_M + (0.5 + 0.5j) * size
    x, y = np.floor(at.real).astype(np.int64), np.floor(at.imag).astype(np.int64)
    inside = (x >= 0) & (y >= 0) & (x < size) & (y < size)
    out[y[inside], x[inside]] = 1.0
    return out


def placements(a: Picture, b: Picture) -> FloatArray:
    """(p, 3) T_a_b of the most likely placements of b in a, best first, and different from each
    other."""
    parts = b.stretches if any(map(len, a.walls)) and len(b.pose) else ()
    cases = [(part, along) for part in parts for along in _turns(a, b, part)]
    if not cases:
        return np.zeros((0, 3))
    peaks: dict[tuple[int, int], list[tuple[float, complex]]] = defaultdict(list)
    for tile in a.tiles:
        for k, (part, along) in enumerate(cases):
            for quarter, score, there in _laid_over(tile, part, along + a.turn):
                shift = there * np.exp(-1j * a.turn)
                peaks[k, quarter].append((score, tile.square.middle + shift))
    turns, middles, shifts, scores = [], [], [], []
    for (k, quarter), found in sorted(peaks.items()):
        part, along = cases[k]
        turn = along + quarter * np.pi / 2
        for score, there in sorted(found, key=lambda peak: -peak[0])[:PEAKS]:
            turns.append(turn)
            middles.append(part.middle)
            shifts.append(there - np.exp(1j * turn) * part.middle)
            scores.append(max(score, 0.0))
    return _agreeing(*map(np.array, (turns, shifts, middles, scores)))


def _laid_over(tile: Tile, part: Stretch, turn: float) -> Iterator[tuple[int, float, complex]]:
    """The best places of a stretch, turned, in a tile: by how many quarter turns more, how well its
    walls fit, and where its middle lies from the tile's, x + iy [m]."""
    square = tile.square
    whole = (square.size, square.size)
    # Drawn on a square as small as the stretch, with a rim for the filters, as if cut from the
    # middle of one as large as the tile.
    side = min(2 * int(part.reach_m / PIXEL_M) + 10 + square.size % 2, square.size)
    rim = (square.size - side) // 2
    drawn = _drawn(part.walls, part.free, turn, part.middle, side)
    count = int(drawn[0].sum())
    walls, fit = (np.conj(fft.rfft2(picture, whole)) for picture in drawn)
    pixel = _signed(np.arange(square.size) - rim, square.size)
    outside = np.abs(pixel) > square.inner // 2
    for quarter, (tile_walls, tile_fit) in enumerate(tile.quarters):
        score = fft.irfft2(tile_fit * walls + tile_walls * fit, whole, overwrite_x=True)
        score[outside] = score[:, outside] = -np.inf
        for y, x, most in _peaks(score):
            # More walls tell more, but a large stretch is no better placed than others.
            fits = most / (2 * count) * min(count, 400)
            yield quarter, fits, 1j**quarter * complex(pixel[x], pixel[y]) * PIXEL_M


def _turns(a: Picture, b: Picture, part: Stretch) -> list[float]:
    """The turns within a quarter that may lay the walls of a stretch of b along those of a [rad]:
    by its own directions, and by those of all stretches, if that differs.

    Furniture, and wings at an angle, mislead the former, drift the latter. Of 61 saved maps,
    turned, cropped or furnished, 59 are placed right by one of the placements with the former
    alone, 61 with both.
    """
    own = _turn(a.directions, part.directions)
    usual = _turn(a.local_directions, b.local_directions)
    differ = abs(float(wrap(4 * (own - usual)))) / 4 > SAME_RAD / 2
    return [own, usual] if differ else [own]


def _turn(one: FloatArray, two: FloatArray) -> float:
    """The turn within a quarter that lays the walls of two along those of one [rad]."""
    both = fft.irfft(fft.rfft(one) * np.conj(fft.rfft(two)), ANGLES)
    return float(np.argmax(both)) * np.pi / 2 / ANGLES


def _peaks(score: NDArray[np.float32]) -> Iterator[tuple[int, int, float]]:
    """The best pixels of a picture, apart from each other; it is used up."""
    size, around = len(score), np.arange(-4, 5)
    for _ in range(PEAKS):
        y, x = divmod(int(score.argmax()), size)
        yield y, x, float(score[y, x])
        score[np.ix_((y + around) % size, (x + around) % size)] = -np.inf


def _signed(pixel: IntArray, size: int) -> IntArray:
    return (pixel + size // 2) % size - size // 2


def _agreeing(
    turn: FloatArray, shift: ComplexArray, middle: ComplexArray, score: FloatArray
) -> FloatArray:
    """(p, 3) the placements that most stretches support: each counts once, by its best. Those of
    one stretch, by its middle, follow each other."""
    unit = np.exp(1j * turn)
    there = unit[:, None] * middle  # of every placement (row), where it turns every stretch to
    gap = np.abs(np.diag(there) + shift - there - shift[:, None])
    alike = gap < SAME_M + SAME_PER_M * np.abs(middle - middle[:, None])
    alike &= np.abs(wrap(turn - turn[:, None])) < SAME_RAD
    begins = np.flatnonzero(np.diff(middle, prepend=np.nan))
    support = np.maximum.reduceat(np.where(alike, score, 0.0), begins, axis=1).sum(axis=1)
    out: list[int] = []
    for k in np.lexsort((shift.imag, shift.real, turn, -support)).tolist():
        here = unit[k] * middle[k] + shift[k]
        apart = (
            abs(here - unit[o] * middle[k] - shift[o]) > MATCH.place_m
            or abs(float(wrap(turn[k] - turn[o]))) > MATCH.turn_rad
            for o in out
        )
        if all(apart):
            out.append(k)
        if len(out) == MOST_PLACEMENTS:
            break
    rows: IntArray = np.array(out, np.int64)
    return np.stack([shift[rows].real, shift[rows].imag, wrap(turn[rows])], axis=1)
