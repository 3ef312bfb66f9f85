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


def test_a_break_parts_the_raw_track(make_map: Make, drive: Drive) -> None:
    topomap = make_map("r")
    odometry = drive(topomap)
    pose = odometry.pose.copy()
    pose[70:, :2] += 100.0
    broken = Odometry(odometry.time_ns, pose, np.array([70]))
    track = track_of(topomap, broken)
    assert len(track.stretches) == 2
    assert len(track_of(topomap, odometry).stretches) == 1
    longest = max(np.hypot(*np.diff(s, axis=0).T).max() for s in track.stretches)
    assert longest < 5.0


def test_there_is_no_track_without_observations_or_odometry(
    empty_map: TopoMap, make_map: Make, drive: Drive
) -> None:
    none = np.zeros(0, np.int64)
    assert robot_track(empty_map, drive(make_map("r"))) is None
    assert robot_track(make_map("r"), Odometry(none, np.zeros((0, 3)), none)) is None


def test_one_observation_places_the_track(one_vertex: TopoMap) -> None:
    time_ns = np.arange(20) * 10**9
    pose = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])
    track = track_of(one_vertex, Odometry(time_ns, pose, np.zeros(0, np.int64)))
    assert track.bent[7, :2] == pytest.approx([3.0, -2.0])
    assert track.bent[:, :2] == pytest.approx(track.raw[:, :2])
