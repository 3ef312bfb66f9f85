"""Corridors led round walls that their paths cross, for planners that drive straight from node to
node.

A path is the track bent onto the centres of its junctions, so that where these are uncertain, or
runs of one site disagree, it may cut a corner. Lengths and times stay those that were measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.polyline import densely, simplify
from ...topology.run import Grid
from ...topology.topomap import TopoMap

ASIDE_M = 1.0
"""How far from its path a corridor is led at most: it is still the same corridor."""

CLEAR_M = 0.4
"""Half of a way's width where walls have no price: about the radius of a robot and a cell more."""

PRICE = np.array([1.0, 5.0, 50.0])
"""Price of a metre in the open, beside a wall, and in one, which is passed where it cannot be
avoided: a door that was closed at times."""


def led_round(topomap: TopoMap, grid: Grid) -> TopoMap:
    """The map with corridors that cross walls led round them, where there is room within
    `ASIDE_M`. grid: along the axes of the map's frame. O(cells)."""
    walls = _Walls(grid)
    return replace(topomap, paths=tuple(map(walls.led_round, topomap.paths)))


class _Walls:
    """Walls on a grid along the axes, and the price of a metre in each cell (h, w)."""

    def __init__(self, grid: Grid) -> None:
        self._corner, self._cell_m = np.array(grid.origin[:2]), grid.resolution_m
        self._wall: BoolArray = ~grid.free & ~grid.unknown
        room_m = distance_transform_edt(~self._wall) * self._cell_m
        self._price: FloatArray = np.interp(room_m, [0.0, CLEAR_M], PRICE[1::-1])
        self._price[self._wall] = PRICE[2]

    def _at(self, xy: FloatArray) -> IntArray:
        """(2, k) rows and columns of points (k, 2), those of the border for points beyond."""
        cells = np.floor((xy - self._corner) / self._cell_m)[:, ::-1]
        within = np.clip(cells, 0, np.array(self._wall.shape) - 1)
        return np.asarray(within.T, np.int64)

    def _crossed(self, path: FloatArray) -> int:
        """How many of the points along a path are in a wall."""
        return int(self._wall[*self._at(densely(path, self._cell_m / 2))].sum())

    def led_round(self, path: FloatArray) -> FloatArray:
        """The path, or the cheapest one near it if that crosses less of walls."""
        from skimage.graph import MCP_Geometric

        crossed = self._crossed(path)
        if not crossed:
            return path
        line = self._at(densely(path, self._cell_m / 2))
        most = int(ASIDE_M / self._cell_m)
        low = np.maximum(line.min(axis=1) - most, 0)
        high = line.max(axis=1) + most + 1
        box = np.s_[low[0] : high[0], low[1] : high[1]]
        off = np.ones(self._price[box].shape, bool)
        off[*(line - low[:, None])] = False
        near = distance_transform_edt(off) <= most
        search = MCP_Geometric(np.where(near, self._price[box], -1.0))
        search.find_costs([line[:, 0] - low])
        cells = np.array(search.traceback(line[:, -1] - low)) + low
        middles = self._corner + (cells[:, ::-1] + 0.5) * self._cell_m
        found = np.concatenate([path[:1], middles[1:-1], path[-1:]])
        found = simplify(found, self._cell_m)
        return found if self._crossed(found) < crossed else path
