"""Candidate placements from views: the walls of one map found in another by cross-correlation.

Stretches of one map's way are laid over the whole other map (FFT), rotated so that walls lie along
walls. The correlation peaks of a stretch are its placements. Stretches with similar placements
support each other, so that maps bent by drift are found as well.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.spatial import cKDTree

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.matching.views import ViewIndex
from ...topology.se2 import wrap, xy_as_complex
from ...topology.views import CELL_M, FREE, REACH_M, Views
from .settings import MATCH

PIXEL_M = 0.4
"""Side of a pixel: walls that drift and rotations have shifted by half a pixel still meet."""
STRETCH_M, STEP_M = 24.0, 12.0
"""Length of the stretches, and distance from one to the next. Of 19 pairs of five real and
simulated buildings whose true placement is found at all, none was lost with 16 or 36 m, and more
led."""
MOST_STRETCHES = 16
"""Stretches of a map that are searched: more take time and add little."""
MOST_PIXELS = 512
"""Side of the squares, 205 m, that larger maps are cut into. Of runs through tunnels and streets
most squares are empty."""
OVERLAP_M = STRETCH_M + 4 * REACH_M
"""Overlap of the squares: a stretch whose middle lies in one lies in it as a whole."""
PEAKS = 3
"""Correlation peaks that are kept for each stretch and rotation."""
CONTRADICTS = 4.0
"""Weight of a wall in the free space of the other map, against one that agrees. With 1 the true
placement leads in 6 of 16 pairs of real runs, with 2 in 7, with 3, 4 and 8 in 11."""
ANGLES = 90
"""Directions of walls that are distinguished within a quarter turn: 1° each."""
MOST_POINTS = 3000
"""Wall cells that are projected: a sample of larger maps gives the same directions."""
LEAST_WALLS = 30
"""Least number of wall cells of a stretch."""
MOST_PLACEMENTS = 8
"""Placements that are registered."""
SAME_M, SAME_PER_M, SAME_RAD = 3 * PIXEL_M, 0.05, 0.2
"""Largest difference between placements of stretches that support each other, in shift, in shift
per metre between the stretches (3° of drift), and in rotation."""

CACHED_MAPS = 256
"""Maps whose repeats, revisits and mirror images a process caches: as many as it has prepared."""
CACHED_VIEWS = 3000
"""Views of cached pictures, 150 kB each: a tile of tasks has 16 maps a side of about 100 views, and
the next tile shares one of the sides."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The views of a map, prepared to be laid over those of another."""

    views: Views
    index: ViewIndex

    @property
    def pose(self) -> FloatArray:
        """(n, 3) poses of the views."""
        return self.views.pose

    @cached_property
    def place(self) -> ComplexArray:
        """(n,) positions of the views, x + iy [m]."""
        return xy_as_complex(self.pose)

    @cached_property
    def arc_m(self) -> FloatArray:
        """(n,) way from the first view to each [m]."""
        return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self.place)))])

    def walls(self, rows: IntArray | slice = slice(None)) -> ComplexArray:
        """Wall cells of some views, x + iy [m]."""
        place, unit = self.place[rows, None], np.exp(1j * self.pose[rows, 2, None])
        return np.asarray((place + unit * self.index.points[rows])[self.index.is_point[rows]])

    def free(self, rows: IntArray) -> ComplexArray:
        """Every second free cell of some views, a pixel apart, x + iy [m]."""
        view, y, x = np.nonzero(self.views.cells[rows, ::2, ::2] == FREE)
        offset = (2 * x + 0.5) * CELL_M - REACH_M + 1j * ((2 * y + 0.5) * CELL_M - REACH_M)
        return np.asarray(self.place[rows][view] + np.exp(1j * self.pose[rows, 2])[view] * offset)

    @cached_property
    def nearest(self) -> cKDTree:
        """Nearest-neighbour index of the positions."""
        return cKDTree(self.pose[:, :2])

    @cached_property
    def directions(self) -> FloatArray:
        """(ANGLES,) `directions` of all walls."""
        return directions(self.walls())

    @cached_property
    def local_directions(self) -> FloatArray:
        """(ANGLES,) sum of the directions of the stretches: in `directions` a few long walls
        outweigh the many short ones of single stretches."""
        return np.asarray(sum((part.directions for part in self.stretches), np.zeros(ANGLES)))

    @cached_property
    def rotation(self) -> float:
        """The rotation that lays the walls along the axes [rad]."""
        return -float(np.argmax(self.directions)) * np.pi / 2 / ANGLES

    @cached_property
    def squares(self) -> list[Square]:
        """The squares that the map is drawn on: one, or as many as have walls."""
        walls = np.exp(1j * self.rotation) * self.walls()
        low = complex(walls.real.min(), walls.imag.min())
        high = complex(walls.real.max(), walls.imag.max())
        extent = max((high - low).real, (high - low).imag)
        size = int((extent + STRETCH_M + 2 * REACH_M) / PIXEL_M) + 4
        if size <= MOST_PIXELS:
            size = int(fft.next_fast_len(size, real=True))
            return [Square((low + high) / 2 * np.exp(-1j * self.rotation), size, size)]
        inner = MOST_PIXELS - int(OVERLAP_M / PIXEL_M)
        step = inner * PIXEL_M
        # The middle of a stretch lies up to half of its length beside the walls of this map.
        aside = np.add.outer([-1, 0, 1], np.multiply([-1, 0, 1], 1j)).ravel() * STRETCH_M / 2
        cells = [_whole_numbers((walls - low + offset) / step) for offset in aside]
        middles = low + (np.unique(np.concatenate(cells)) + 0.5 + 0.5j) * step
        return [Square(z, MOST_PIXELS, inner) for z in middles * np.exp(-1j * self.rotation)]

    @property
    def tiles(self) -> Iterable[Tile]:
        """The map drawn on its squares. Several are drawn one at a time."""
        return (self._whole,) if len(self.squares) == 1 else map(self._tile, self.squares)

    @cached_property
    def _whole(self) -> Tile:
        return self._tile(self.squares[0])

    def _tile(self, square: Square) -> Tile:
        reach = square.size * PIXEL_M + REACH_M  # more than half of the diagonal
        rows = np.flatnonzero(np.abs(self.place - square.middle) < reach)
        points = self.walls(rows), self.free(rows)
        image, fit = _images(*points, self.rotation, square.middle, square.size)
        spectra = tuple(
            (fft.rfft2(np.rot90(image, quarter)), fft.rfft2(np.rot90(fit, quarter)))
            for quarter in range(4)
        )
        return Tile(square, spectra)

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """The stretches of its way."""
        return tuple(self._stretches())

    def _stretches(self) -> Iterator[Stretch]:
        starts = np.arange(0.0, max(self.arc_m[-1] - STRETCH_M, 0.0) + STEP_M, STEP_M)
        for start in starts[evenly_spread(len(starts), MOST_STRETCHES)].tolist():
            rows = np.flatnonzero((self.arc_m >= start) & (self.arc_m <= start + STRETCH_M))
            if not len(rows):
                continue
            # A jump from one view to the next tears a stretch apart.
            rows = rows[np.abs(self.place[rows] - np.median(self.place[rows])) < STRETCH_M / 2]
            walls = self.walls(rows)
            if len(walls) >= LEAST_WALLS:
                middle = complex(self.place[rows].mean())
                near, free = ((z - middle).astype(np.complex64) for z in (walls, self.free(rows)))
                yield Stretch(near, free, middle, directions(walls))


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Walls and free space of a stretch of way, from its middle, the middle, x + iy [m], and
    `directions`."""

    walls: NDArray[np.complex64]
    free: NDArray[np.complex64]
    middle: complex
    directions: FloatArray

    @property
    def reach_m(self) -> float:
        """Distance of the farthest cell from the middle [m]."""
        return max(float(np.abs(z).max(initial=0)) for z in (self.walls, self.free))


def evenly_spread(count: int, most: int) -> IntArray:
    """Up to `most` of so many rows, evenly spread."""
    rows = np.rint(np.linspace(0, count - 1, min(count, most)))
    return np.unique(rows.astype(np.int64))


_pictures: OrderedDict[Views, Picture] = OrderedDict()


def pictured(views: Views) -> Picture:
    """The picture of a map's views. The last used ones are cached: `CACHED_VIEWS`, but two maps."""
    known = views in _pictures
    picture = _pictures.pop(views) if known else Picture(views, ViewIndex.of(views))
    _pictures[views] = picture
    while len(_pictures) > 2 and sum(map(len, _pictures)) > CACHED_VIEWS:
        _pictures.popitem(last=False)
    return picture


def directions(walls: ComplexArray) -> FloatArray:
    """(ANGLES,) how clearly walls lie along or across each direction.

    Walls are projected on both axes into strips as wide as a cell: where they lie along the axes,
    few strips hold most cells. (Averaged normals err by 6° where cells lie along other axes.)
    """
    z = walls[:: -(-len(walls) // MOST_POINTS)] if len(walls) else walls
    if not len(z):
        return np.zeros(ANGLES)
    rotated = np.exp(-0.5j * np.pi * np.arange(ANGLES) / ANGLES)[:, None] * (z - z.mean())
    strips = int(2 * np.abs(z - z.mean()).max() / CELL_M) + 4
    squares = np.zeros(ANGLES)
    for across in (rotated.real, rotated.imag):
        strip = (across / CELL_M + strips / 2).astype(np.int64)
        strip += strips * np.arange(ANGLES)[:, None]
        count = np.bincount(strip.reshape(-1), minlength=strips * ANGLES).reshape(ANGLES, strips)
        squares += (count.astype(np.float64) ** 2).sum(axis=1)
    return np.maximum(squares / np.median(squares) - 1.0, 0.0)


Spectra = tuple[NDArray[np.complex64], NDArray[np.complex64]]
"""Fourier transforms of an image of the walls, and of how well a wall of another map fits."""


@dataclass(frozen=True, slots=True)
class Square:
    """A square of size × size pixels around `middle`, x + iy [m]. It is searched for stretches
    whose middles lie within the central inner × inner pixels."""

    middle: complex
    size: int
    inner: int


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A map drawn on a square, rotated by `Picture.rotation`, and from there by 0 to 3 quarter
    turns, clockwise in the map's frame."""

    square: Square
    quarters: tuple[Spectra, ...]


def _images(
    walls: NDArray[Any], free: NDArray[Any], rotation: float, middle: complex, size: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(size, size) images of walls and free space, x + iy [m], rotated [rad] about a middle: the
    walls, and how well a wall of another map fits."""
    wall, clear = (_marked(z, rotation, middle, size) for z in (walls, free))
    near = np.minimum(2.5 * ndimage.gaussian_filter(wall, 0.7), 1.0)
    against = clear * (ndimage.maximum_filter(wall, 3) == 0)
    return wall, np.maximum(wall, near) - np.float32(CONTRADICTS) * against


def _marked(z: NDArray[Any], rotation: float, middle: complex, size: int) -> NDArray[np.float32]:
    """(size, size) 1 at the pixels of points z, rotated about a middle, else 0."""
    image = np.zeros((size, size), np.float32)
    pixel = (z - middle) * np.exp(1j * rotation) / PIXEL_M + (0.5 + 0.5j) * size
    x, y = np.floor(pixel.real).astype(np.int64), np.floor(pixel.imag).astype(np.int64)
    inside = (x >= 0) & (y >= 0) & (x < size) & (y < size)
    image[y[inside], x[inside]] = 1.0
    return image


def placements(a: Picture, b: Picture) -> FloatArray:
    """(p, 3) T_a_b of the most likely placements of b in a, best first, and different from each
    other."""
    stretches = b.stretches if a.index.is_point.any() and len(b.pose) else ()
    cases = [(stretch, along) for stretch in stretches for along in _rotations(a, b, stretch)]
    if not cases:
        return np.zeros((0, 3))
    peaks: dict[tuple[int, int], list[tuple[float, complex]]] = defaultdict(list)
    for tile in a.tiles:
        for k, (stretch, along) in enumerate(cases):
            for quarter, score, offset in _correlated(tile, stretch, along + a.rotation):
                middle = tile.square.middle + offset * np.exp(-1j * a.rotation)
                peaks[k, quarter].append((score, middle))
    turns, middles, shifts, scores = [], [], [], []
    for (k, quarter), found in sorted(peaks.items()):
        stretch, along = cases[k]
        turn = along + quarter * np.pi / 2
        for score, middle in sorted(found, key=lambda peak: -peak[0])[:PEAKS]:
            turns.append(turn)
            middles.append(stretch.middle)
            shifts.append(middle - np.exp(1j * turn) * stretch.middle)
            scores.append(max(score, 0.0))
    return _supported(*map(np.array, (turns, shifts, middles, scores)))


def _correlated(
    tile: Tile, stretch: Stretch, rotation: float
) -> Iterator[tuple[int, float, complex]]:
    """The best placements of a stretch in a tile, at a rotation [rad] and its quarter turns: number
    of quarter turns, score of the fit, and offset of the middles, x + iy [m]."""
    square = tile.square
    shape = (square.size, square.size)
    # Drawn on a square as small as the stretch, with a rim for the filters, as if cut from the
    # middle of one as large as the tile.
    side = min(2 * int(stretch.reach_m / PIXEL_M) + 10 + square.size % 2, square.size)
    rim = (square.size - side) // 2
    images = _images(stretch.walls, stretch.free, rotation, 0j, side)
    count = int(images[0].sum())
    walls, fit = (np.conj(fft.rfft2(image, shape)) for image in images)
    pixel = _signed(np.arange(square.size) - rim, square.size)
    outside = np.abs(pixel) > square.inner // 2
    for quarter, (tile_walls, tile_fit) in enumerate(tile.quarters):
        score = fft.irfft2(tile_fit * walls + tile_walls * fit, shape, overwrite_x=True)
        score[outside] = score[:, outside] = -np.inf
        for y, x, most in _peaks(score):
            # The mean fit, weighted by the number of walls up to 400.
            weighted = most / (2 * count) * min(count, 400)
            yield quarter, weighted, 1j**quarter * complex(pixel[x], pixel[y]) * PIXEL_M


def _rotations(a: Picture, b: Picture, stretch: Stretch) -> list[float]:
    """The rotations within a quarter turn that may lay the walls of a stretch of b along those of a
    [rad]: by its own directions, and by those of all stretches, if that differs.

    Furniture, and wings at an angle, mislead the former, drift the latter. Of 61 saved maps,
    turned, cropped or furnished, 59 are placed right by one of the placements with the former
    alone, 61 with both.
    """
    by_stretch = _rotation(a.directions, stretch.directions)
    by_all = _rotation(a.local_directions, b.local_directions)
    differ = abs(float(wrap(4 * (by_stretch - by_all)))) / 4 > SAME_RAD / 2
    return [by_stretch, by_all] if differ else [by_stretch]


def _rotation(directions_a: FloatArray, directions_b: FloatArray) -> float:
    """The rotation within a quarter turn that lays the walls of b along those of a [rad]."""
    correlation = fft.irfft(fft.rfft(directions_a) * np.conj(fft.rfft(directions_b)), ANGLES)
    return float(np.argmax(correlation)) * np.pi / 2 / ANGLES


def _peaks(score: NDArray[np.float32]) -> Iterator[tuple[int, int, float]]:
    """Row, column and value of the `PEAKS` best pixels, not adjacent; overwrites `score`."""
    size, around = len(score), np.arange(-4, 5)
    for _ in range(PEAKS):
        y, x = divmod(int(score.argmax()), size)
        yield y, x, float(score[y, x])
        score[np.ix_((y + around) % size, (x + around) % size)] = -np.inf


def _whole_numbers(z: ComplexArray) -> ComplexArray:
    """The different values of z, rounded down."""
    return np.unique(np.floor(z.real) + 1j * np.floor(z.imag))


def _signed(pixel: IntArray, size: int) -> IntArray:
    """Cyclic shifts as shifts between -size / 2 and size / 2."""
    return (pixel + size // 2) % size - size // 2


def _supported(
    turn: FloatArray, shift: ComplexArray, middle: ComplexArray, score: FloatArray
) -> FloatArray:
    """(p, 3) the placements that most stretches support, best first and different from each other.

    turn, shift, score: (k,) placements of single stretches; middle: (k,) of the stretch of each,
    equal for consecutive rows. A stretch supports a placement once, by its own best one near it.
    """
    unit = np.exp(1j * turn)
    rotated = unit[:, None] * middle  # the middle of every stretch, by every placement (row)
    gap = np.abs(np.diag(rotated) + shift - rotated - shift[:, None])
    alike = gap < SAME_M + SAME_PER_M * np.abs(middle - middle[:, None])
    alike &= np.abs(wrap(turn - turn[:, None])) < SAME_RAD
    begins = np.flatnonzero(np.diff(middle, prepend=np.nan))
    support = np.maximum.reduceat(np.where(alike, score, 0.0), begins, axis=1).sum(axis=1)
    chosen: list[int] = []
    for k in np.lexsort((shift.imag, shift.real, turn, -support)).tolist():
        placed = unit[k] * middle[k] + shift[k]
        apart = (
            abs(placed - unit[other] * middle[k] - shift[other]) > MATCH.place_m
            or abs(float(wrap(turn[k] - turn[other]))) > MATCH.turn_rad
            for other in chosen
        )
        if all(apart):
            chosen.append(k)
        if len(chosen) == MOST_PLACEMENTS:
            break
    rows: IntArray = np.array(chosen, np.int64)
    return np.stack([shift[rows].real, shift[rows].imag, wrap(turn[rows])], axis=1)
