from collections.abc import Callable

import numpy as np
import pytest

from topobatch.topology.odometry import Odometry
from topobatch.topology.se2 import compose
from topobatch.topology.topomap import TopoMap
from topobatch.viz.robot_track import RobotTrack, robot_track

Drive = Callable[[TopoMap], Odometry]
Make = Callable[..., TopoMap]


def track_of(topomap: TopoMap, odometry: Odometry) -> RobotTrack:
    track = robot_track(topomap, odometry)
    assert track is not None
    return track


def test_perfect_odometry_in_another_frame_lies_on_the_map(make_map: Make, drive: Drive) -> None:
    topomap = make_map("r", (3.0, -8.0, 2.0))
    odometry = drive(topomap)
    moved = Odometry(odometry.time_ns, compose([9.0, 1.0, -1.3], odometry.pose), odometry.breaks)
    track = track_of(topomap, moved)
    assert track.drift_m == pytest.approx(np.zeros(8), abs=1e-9)
    rows = np.searchsorted(odometry.time_ns, track.time_ns)
    assert track.raw[:, :2] == pytest.approx(odometry.pose[rows, :2], abs=1e-9)
    assert track.bent[:, :2] == pytest.approx(odometry.pose[rows, :2], abs=1e-9)


def test_drifting_odometry_is_bent_onto_the_vertices(make_map: Make, drive: Drive) -> None:
    topomap = make_map("r")
    odometry = drive(topomap)
    turn = 0.02 * np.arange(len(odometry)) / 10
    step = np.diff(odometry.pose[:, :2], axis=0)
    c, s = np.cos(turn[1:]), np.sin(turn[1:])
    turned = np.stack([c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]], axis=-1)
    xy = np.concatenate([[[0.0, 0.0]], np.cumsum(turned, axis=0)])
    pose = np.column_stack([xy, odometry.pose[:, 2] + turn])
    track = track_of(topomap, Odometry(odometry.time_ns, pose, odometry.breaks))
    assert track.drift_m.max() > 0.5
    # Rows are thinned to 5 cm of way (the robot makes up to 0.5 m from row to row here).
    for time_ns, vertex in zip(
        topomap.observation_time_ns, topomap.observation_vertex, strict=True
    ):
        nearest = np.argmin(np.abs(track.time_ns - time_ns))
        assert np.hypot(*(track.bent[nearest, :2] - topomap.xy[vertex])) < 0.55
