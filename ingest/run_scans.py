"""The scans of a run's log, read again and laid onto its map, and the occupancy grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..topology.arrays import FloatArray, IntArray
from ..topology.columns import take
from ..topology.errors import DataError
from ..topology.grids import cropped, grid_at
from ..topology.run import Grid, Run
from ..topology.se2 import compose
from ..topology.topomap import TopoMap
from ..topology.visits import carried_along
from .read_settings import ReadSettings
from .reading import read_log
from .remote.path import LogPath
from .scans.grid import GridSettings, looks
from .scans.keyframes import Keyframes
from .scans.windows import window_places

LEAST_SHARE = 0.5
"""Share of the times of a map's views at which a log has keyframes as well, if the map was made
from it: on another processor some may lie a scan apart."""


@dataclass(frozen=True, slots=True, eq=False)
class LaidScans:
    """Scans of a run, and the robot's poses (k, 3) at these in the frame of its map."""

    keyframes: Keyframes
    body: FloatArray


def scans_on_map(
    log: LogPath,
    settings: ReadSettings,
    topomap: TopoMap,
    *,
    on_bytes: Callable[[int], None] | None = None,
) -> LaidScans:
    """Read the scans of the log that a map with views was made from again. DataError if its views
    are others than the map's. on_bytes: as of `read_log`."""
    if "views" in topomap.info.get("source", {}):  # its junctions are of another topic
        settings = replace(settings, junctions_from="scan")
    kept: list[Keyframes] = []
    found = read_log(log, settings, on_bytes=on_bytes, on_keyframes=kept.append)
    if not isinstance(found, Run) or found.scanned is None or not kept:
        raise DataError(f"{log}: holds no scans")
    (frames,) = kept[-1:]
    odometry, placed = found.odometry, topomap.views
    again = np.isin(placed.time_ns, odometry.time_ns)
    if not len(again) or again.mean() < LEAST_SHARE:
        raise DataError(
            f"{log}: its scans are not those that the map of run {topomap.run} was made from"
        )
    # Every view tells where its surroundings in the odometry's frame came to lie in the map.
    time_ns, pose = placed.time_ns[again], placed.pose[again]
    at = time_ns, pose, window_places(odometry, time_ns)
    body = carried_along(odometry, at, frames.time_ns, odometry.at(frames.time_ns))
    # The map may be of a piece of the log alone.
    known = np.flatnonzero(np.isfinite(body).all(axis=1))
    return LaidScans(take(frames, known), body[known])


AT_ONCE = 32
"""Keyframes that are cast at once: of cells of 0.05 m, 13 MB."""


class Occupancy:
    """Numbers of scans that hit each cell, and that saw through it, in one frame for all runs.

    The wall of a run that lies a cell beside that of another is kept: by the settings' share of
    hits a cell is a wall, though others see through it.
    """

    def __init__(self, cell_m: float) -> None:
        self.cell_m = cell_m
        self._settings = GridSettings(cell_m=cell_m, wall_hits=1)
        self._first = np.zeros(2, np.int64)
        self._looks = np.zeros((2, 0, 0), np.uint32)

    def add(self, frames: Keyframes, body: FloatArray) -> None:
        """Cast the beams of a run's keyframes with the robot at `body` (k, 3). O(k cells within
        reach)."""
        if not len(frames):
            return
        laser = compose(body, frames.mount)
        half = round(self._settings.reach_m / self.cell_m)
        own = np.floor(laser[:, :2] / self.cell_m).astype(np.int64)
        self._reach(own.min(axis=0) - half, own.max(axis=0) + half + 1)
        for begin in range(0, len(frames), AT_ONCE):
            some = slice(begin, begin + AT_ONCE)
            seen = looks(take(frames, some), laser[some], self._settings)
            for k, (x, y) in enumerate((seen.corner - self._first).tolist()):
                patch = np.s_[y : y + seen.hit.shape[1], x : x + seen.hit.shape[2]]
                self._looks[0][patch] += seen.hit[k]
                self._looks[1][patch] += seen.free[k]

    def _reach(self, low: IntArray, beyond: IntArray) -> None:
        """Make room for cells from `low` up to `beyond` (2,)."""
        size: IntArray = np.array(self._looks.shape[:0:-1])
        if size.any():
            low = np.minimum(low, self._first)
            beyond = np.maximum(beyond, self._first + size)
        x, y = (self._first - low).tolist()
        grown: NDArray[np.uint32] = np.zeros((2, *(beyond - low)[::-1].tolist()), np.uint32)
        if size.any():
            grown[:, y : y + size[1], x : x + size[0]] = self._looks
        self._first, self._looks = low, grown

    def grid(self, frame: str) -> Grid | None:
        """The grid; None if nothing was seen."""
        hit, free = self._looks
        share = self._settings.wall_share
        wall = (hit >= self._settings.wall_hits) & (hit > share * (hit + free.astype(np.float32)))
        return cropped(grid_at(self._first, wall, free > 0, self.cell_m, frame))
