"""Occupancy grids of the surroundings of a place, from aligned keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.se2 import apply, wrap
from .keyframes import Keyframes


@dataclass(frozen=True, slots=True)
class GridSettings:
    """When cells are walls or free."""

    cell_m: float = 0.1
    """Side of a cell: a doorway has nine."""
    reach_m: float = 8.0
    """Distance up to which cells are observed: beyond, beams are more than a cell apart."""
    wall_hits: int = 2
    wall_share: float = 0.15
    """A wall is hit by at least `wall_hits` keyframes, and by this share of its observations;
    people walking by are hit by few."""
    strip_m: float = 0.3
    """Half the width of the strip along the track that is free because the robot drove there."""
    island_m: float = 2.0
    """Smaller isolated obstacles (pillars, furniture, people) are not walls."""


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """Observations of cells by every keyframe: patches (k, s, s) of cells seen through and of cells
    hit, row y, column x; corner: (k, 2) lattice cell (x, y) of each patch's first."""

    free: BoolArray
    hit: BoolArray
    corner: IntArray


@lru_cache(maxsize=4)
def _patch(half: int, cell_m: float) -> tuple[Float32Array, Float32Array]:
    """Bearing and distance of every cell of a patch from its centre."""
    step = np.arange(-half, half + 1) * cell_m
    x, y = np.meshgrid(step, step)
    return np.arctan2(y, x).astype(np.float32), np.hypot(x, y).astype(np.float32)


def looks(frames: Keyframes, pose: FloatArray, settings: GridSettings = GridSettings()) -> Looks:
    """Cast the beams of keyframes at `pose` (k, 3) into cells of the poses' frame.

    Inverse ray casting: each cell looks up the beam in its direction, with the laser at the centre
    of its own cell, an error of at most 0.05 m, less than the cell by which beams are shortened.
    """
    half = round(settings.reach_m / settings.cell_m)
    bearing, distance = _patch(half, settings.cell_m)
    k, m = frames.xy.shape[:2]
    side = 2 * half + 1
    free, hit = np.zeros((k, side, side), bool), np.zeros((k, side, side), bool)
    own = np.floor(pose[:, :2] / settings.cell_m).astype(np.int64)
    corner = own - half
    ranges = np.hypot(frames.xy[..., 0], frames.xy[..., 1])
    echo = np.isfinite(ranges)
    nearer, farther = _beside(ranges, echo)
    reached = np.minimum(nearer, frames.free[:, None])
    reached[_blanked(frames.laser, echo, farther < 0.5 * frames.free[:, None])] = 0
    through = np.where(echo, ranges - settings.cell_m, reached)
    # One beam more than there are, seen through nowhere: for cells out of the field of view.
    through = np.pad(through, ((0, 0), (0, 1))).astype(np.float32)
    through = np.minimum(through, settings.reach_m)
    middle = 0.5 * frames.increment * (frames.beams - 1)
    half_turn, whole = np.float32(np.pi), np.float32(2 * np.pi)
    for row in range(k):
        ahead = np.float32(wrap(pose[row, 2] + frames.start[row] + middle[row]))
        turn = bearing - (ahead - half_turn)
        turn -= whole * (turn >= whole)
        turn += whole * (turn < 0)
        turn -= half_turn
        beam = np.rint((turn + np.float32(middle[row])) / np.float32(frames.increment[row]))
        beam = np.where((beam >= 0) & (beam < frames.beams[row]), beam, m).astype(np.int16)
        free[row] = distance < through[row][beam]
        at = echo[row] & (ranges[row] < settings.reach_m - settings.cell_m)
        ends = apply(pose[row], frames.xy[row, at].astype(np.float64))
        x, y = (np.floor(ends / settings.cell_m).astype(np.int64) - corner[row]).T
        hit[row, y, x] = True
    return Looks(free & ~hit, hit, corner)


def _blanked(laser: IntArray, echo: BoolArray, near: BoolArray) -> BoolArray:
    """(k, m) beams of lasers (k,) without a return in any scan although there were `near` walls on
    both sides: the robot itself is in their way, or a filter removes them."""
    out = np.zeros(echo.shape, bool)
    for number in np.unique(laser):
        own = laser == number
        out[own] = near[own].any(axis=0) & ~echo[own].any(axis=0)
    return out


def _beside(ranges: Float32Array, echo: BoolArray) -> tuple[Float32Array, Float32Array]:
    """(k, m) each: the nearer and the farther of the next returns on either side of every beam, 0
    where there is none.

    A beam without a return between returns hit glass or something dark, not free space.
    """
    beam = np.arange(ranges.shape[1])
    before = np.maximum.accumulate(np.where(echo, beam, -1), axis=1)
    after = np.minimum.accumulate(np.where(echo, beam, len(beam))[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(np.where(echo, ranges, 0), ((0, 0), (1, 1)))
    rows = np.arange(len(ranges))[:, None]
    sides = padded[rows, before + 1], padded[rows, after + 1]
    return np.minimum(*sides), np.maximum(*sides)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A square of the lattice: numbers of keyframes that saw through each cell (s, s), and hit it;
    driven: cells that the robot drove over; corner: (2,) lattice cell (x, y) of the first."""

    free: IntArray
    hit: IntArray
    driven: BoolArray
    corner: IntArray

    def inner(self, cells: int) -> Window:
        """The window without so many cells along its border."""
        within = np.s_[cells:-cells, cells:-cells]
        free, hit, driven = self.free[within], self.hit[within], self.driven[within]
        return Window(free, hit, driven, self.corner + cells)


def gather(
    seen: Looks,
    rows: Sequence[int],
    way_xy: FloatArray,
    place: tuple[FloatArray, int],
    settings: GridSettings,
) -> Window:
    """The observations by keyframes `rows` within `half` cells of a place ((2,), half); way_xy: (w,
    2) the track meanwhile, densely sampled [m]."""
    centre, half = place
    corner = np.floor(centre / settings.cell_m).astype(np.int64) - half
    side = 2 * half + 1
    free, hit = (np.zeros((side, side), np.int64) for _ in range(2))
    patch = seen.free.shape[1]
    # Sums of bytes are several times as fast, and hold up to 255 observations.
    for begin in range(0, len(rows), 255):
        some = [np.zeros((side, side), np.uint8) for _ in range(2)]
        for k in rows[begin : begin + 255]:
            x, y = (seen.corner[k] - corner).tolist()
            ax, bx, ay, by = max(x, 0), min(x + patch, side), max(y, 0), min(y + patch, side)
            if ax < bx and ay < by:
                into, out_of = np.s_[ay:by, ax:bx], np.s_[ay - y : by - y, ax - x : bx - x]
                some[0][into] += seen.free[k, *out_of].view(np.uint8)
                some[1][into] += seen.hit[k, *out_of].view(np.uint8)
        free += some[0]
        hit += some[1]
    driven = np.zeros((side, side), bool)
    x, y = (np.floor(way_xy / settings.cell_m).astype(np.int64) - corner).T
    inside = (x >= 0) & (x < side) & (y >= 0) & (y < side)
    driven[y[inside], x[inside]] = True
    return Window(free, hit, driven, corner)


def free_space(window: Window, settings: GridSettings) -> BoolArray:
    """(s, s) free cells: seen through and no wall, or at most `strip_m` from the track; islands are
    removed."""
    observed = window.hit + window.free
    wall = (window.hit >= settings.wall_hits) & (window.hit > settings.wall_share * observed)
    free = (window.free > 0) & ~wall
    strip = ndimage.binary_dilation(window.driven, disc(round(settings.strip_m / settings.cell_m)))
    return without_islands(free | strip, settings.island_m / settings.cell_m)


def without_islands(
    free: BoolArray, most_cells: float, blocked: BoolArray | None = None
) -> BoolArray:
    """The free cells, and those of obstacles up to so many cells wide that touch no border.

    blocked: what is connected there is one obstacle; by default all that is not free.
    """
    label, _ = labelled(~free if blocked is None else blocked)
    at_border = np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]])
    label[free] = 0
    small = extents(label) <= most_cells
    small[at_border] = False
    return np.asarray(free | small[label])


Labels = NDArray[np.int32]


def labelled(mask: BoolArray) -> tuple[Labels, int]:
    """Connected components of cells (8-connectivity), numbered from 1 on, and their number."""
    label, count = ndimage.label(mask, np.ones((3, 3), np.int8))
    return np.asarray(label, np.int32), int(count)


def extents(label: Labels) -> IntArray:
    """(n + 1,) the longer side of the box around every component, in cells; 0 of what is none."""
    boxes = ndimage.find_objects(label)
    sides = [0, *(max(s.stop - s.start for s in box) if box else 0 for box in boxes)]
    return np.array(sides)


def disc(radius: int) -> BoolArray:
    """(2 r + 1, 2 r + 1) cells within `radius` of the centre."""
    step = np.arange(-radius, radius + 1)
    return np.asarray(step[:, None] ** 2 + step**2 <= (radius + 0.5) ** 2)
