"""A detector's raw messages on the map: junction positions and branch directions."""

from __future__ import annotations

import numpy as np
import rerun as rr

from ..topology.run import Detections
from ..topology.se2 import compose
from . import palette
from .recording import PathParts, Recording
from .robot_track import RobotTrack

MOST_DETECTIONS = 20_000
"""More detections are thinned evenly to this count."""

BRANCH_M = 0.8
"""Length of a drawn branch."""


def write_detections(
    recording: Recording, root: PathParts, detections: Detections, track: RobotTrack
) -> None:
    """Write every detection as a dot, and over time its branches as a star, at the poses of the
    corrected track. Detections outside of the track's time range are left out."""
    time_ns = detections.time_ns
    rows = np.flatnonzero((time_ns >= track.time_ns[0]) & (time_ns <= track.time_ns[-1]))
    if len(rows) == 0:
        return
    rows = rows[:: max(1, -(-len(rows) // MOST_DETECTIONS))]
    pose = track.at(time_ns[rows])
    ahead = np.column_stack([detections.centre[rows], np.zeros(len(rows))])
    centre = compose(pose, ahead)[:, :2]
    recording.static(
        (*root, "detections"),
        rr.Points2D(
            centre,
            radii=rr.Radius.ui_points(1.0),
            colors=palette.DETECTION,
            draw_order=palette.Order.SIGHTING,
        ),
    )
    branches = detections.branches.take(rows)
    theta = branches.values + pose[branches.owner, 2]
    ends = BRANCH_M * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    strips = np.stack([centre[branches.owner], centre[branches.owner] + ends], axis=1)
    seen = branches.counts > 0
    if not seen.any():
        return
    columns = rr.LineStrips2D.columns(strips=list(strips)).partition(branches.counts[seen])
    recording.over_time((*root, "detection"), time_ns[rows][seen], columns)
    look = rr.LineStrips2D.from_fields(
        radii=rr.Radius.ui_points(1.5), colors=palette.DETECTION, draw_order=palette.Order.SEEN
    )
    recording.static((*root, "detection"), look)
