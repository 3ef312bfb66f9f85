"""Sanity of time and pose: every disturbance is repaired, counted and reported."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.ingest.odometry.track import sane_track
from topobatch.ingest.reading import read_run

SECOND = 10**9


def straight(n=500, period_ns=20_000_000, speed=0.5):
    time = 1_700_000_000 * SECOND + period_ns * np.arange(n)
    pose = np.zeros((n, 3))
    pose[:, 0] = 1.0 + speed * (time - time[0]) / SECOND
    return time, pose


def track(time, pose):
    return sane_track(time.copy(), pose.copy(), "odom", "base_link")


def test_a_sane_track_is_left_alone():
    time, pose = straight()
    result = track(time, pose)
    assert result.warnings == ()
    assert result.odometry.pose.tolist() == pose.tolist()
    assert result.odometry.time_ns.tolist() == time.tolist()
    assert len(result.odometry.cuts) == 0


def test_messages_out_of_order_are_sorted():
    time, pose = straight()
    order = np.arange(len(time))
    order[[10, 11, 50, 52]] = order[[11, 10, 52, 50]]
    result = track(time[order], pose[order])
    assert result.odometry.pose.tolist() == pose.tolist()
    assert len(result.warnings) == 1
    assert "out of order" in result.warnings[0]


def test_repeated_times_keep_the_first():
    time, pose = straight()
    rows = np.sort(np.concatenate([np.arange(500), [7, 7, 300]]))
    result = track(time[rows], pose[rows])
    assert len(result.odometry) == 500
    assert result.warnings == ("3 odometry messages repeat the time of another and were dropped",)


def test_odometry_that_begins_again_at_the_origin_after_a_pause_is_reset():
    time, pose = straight()
    time[200:] += 10 * SECOND  # time enough to have driven there
    pose[200:] = pose[:300] - pose[0]
    result = track(time, pose)
    assert result.odometry.breaks.tolist() == [200]
    assert "reset once" in result.warnings[0]


def test_a_teleport_farther_than_the_robot_drives_breaks_the_chain():
    time, pose = straight()
    pose[200:] += [7.0, -3.0, 0.0]
    result = track(time, pose)
    odometry = result.odometry
    assert odometry.breaks.tolist() == [200]
    assert "reset once (7.62 m and 0 degrees at 4.0 s)" in result.warnings[0]
    assert odometry.step_m.max() < 0.011


def test_a_single_pose_off_the_track_is_dropped():
    time, pose = straight()
    pose[77] = [100.0, 100.0, 1.0]
    result = track(time, pose)
    assert len(result.odometry) == 499
    assert len(result.odometry.cuts) == 0
    assert "off the track" in result.warnings[0]


def test_gaps_are_reported_and_driving_through_them_is_no_teleport():
    time, pose = straight()
    keep = (np.arange(500) < 100) | (np.arange(500) >= 300)
    result = track(time[keep], pose[keep])
    assert result.warnings == ("odometry is silent once (longest 4.02 s)",)
    assert len(result.odometry.cuts) == 0


@given(
    st.lists(
        st.tuples(
            st.integers(0, 10**11), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-3.2, 3.2)
        ),
        min_size=1,
        max_size=60,
    )
)
@settings(max_examples=100)
def test_anything_finite_becomes_a_valid_track(rows):
    time = np.array([row[0] for row in rows], np.int64)
    pose = np.array([row[1:] for row in rows])
    result = track(time, pose)
    assert 1 <= len(result.odometry) <= len(rows)
    # Turning the world leaves breaks and times as they are.
    c, s = np.cos(0.7), np.sin(0.7)
    turned = pose @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    if not np.any((np.abs(pose[:, :2]) < 1e-3).all(axis=1)):
        assert len(track(time, turned).odometry) == len(result.odometry)


def test_detections_outside_the_odometry_are_left_out(logs, tmp_path):
    messages = logs.drive()
    messages = [m for m in messages if m.topic != "/odom" or m.stamp_ns < logs.START_NS + SECOND]
    run = read_run(logs.mcap(tmp_path / "a.mcap", messages))
    assert any("outside the time of the odometry" in text for text in run.warnings)
    assert len(run.detections) < 30
