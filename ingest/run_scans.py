"""The scans of a run's log, read again and laid onto its map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.columns import take
from ..topology.errors import DataError
from ..topology.run import Run
from ..topology.se2 import compose, inverse
from ..topology.topomap import TopoMap
from ..topology.track import piece_of
from ..topology.visits import Visits, in_map_frame
from .read_settings import ReadSettings
from .reading import read_log
from .remote.path import LogPath
from .scans.keyframes import Keyframes

LEAST_SHARE = 0.5
"""Share of the times of a map's views at which a log has views as well, if the map was made from
it: on another processor some may lie a scan apart."""


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
    odometry, views = found.odometry, found.scanned.views
    _, fresh, stored = np.intersect1d(views.time_ns, topomap.views.time_ns, return_indices=True)
    if len(stored) < LEAST_SHARE * len(np.unique(topomap.views.time_ns)) or not len(stored):
        raise DataError(
            f"{log}: its scans are not those that the map of run {topomap.run} was made from"
        )
    # Every view tells where its surroundings in the odometry's frame came to lie in the map.
    odom, placed = views.pose[fresh], topomap.views.pose[stored]
    turn = compose(placed, inverse(odom))[:, 2]
    visits = Visits(
        time_ns=views.time_ns[fresh],
        vertex=np.arange(len(fresh)),
        seen=np.ones(len(fresh), bool),
        pose=np.column_stack([placed[:, :2], turn]),
        centre=odom[:, :2],
        piece=piece_of(odometry, views.time_ns[fresh]),
    )
    body = odometry.at(frames.time_ns)
    body = in_map_frame(odometry, visits, placed[:, :2], frames.time_ns, body)
    # The map may be of a piece of the log alone.
    known = np.flatnonzero(np.isfinite(body).all(axis=1))
    return LaidScans(take(frames, known), body[known])
