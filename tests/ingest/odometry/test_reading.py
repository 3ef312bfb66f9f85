"""Odometry out of a log: whose clock it goes by, which poses are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.reading import ReadSettings, read_run
from topobatch.topology.errors import LogError

SECOND = 10**9


def disturbed(logs, change):
    """The sample drive with the odometry messages changed one by one."""
    out, number = [], 0
    for message in logs.drive():
        if message.topic == "/odom":
            message = change(number, message)  # noqa: PLW2901
            number += 1
        out.append(message)
    return out


def test_poses_that_are_none_are_left_out(logs, tmp_path):
    def change(k, m):
        x = m.poses[0]
        if k in (5, 6, 7):
            return replace(m, poses=((np.nan, *x[1:]),))
        if k in (20, 21):
            return replace(m, poses=((*x[:3], 0.0, 0.0, 0.0, 0.0),))
        return m

    for run in (
        read_run(logs.mcap(tmp_path / "a.mcap", disturbed(logs, change))),
        read_run(logs.bag(tmp_path / "a.bag", disturbed(logs, change))),
    ):
        assert len(run.odometry) == 295
        assert (
            "/odom: 3 poses hold numbers that are not finite or absurdly large; left out"
            in run.warnings
        )
        assert "/odom: 2 poses have a quaternion of zero length; left out" in run.warnings


def test_messages_without_header_time_go_by_log_time(logs, tmp_path):
    zero = [replace(m, stamp_ns=0) for m in logs.drive()]
    run = read_run(logs.mcap(tmp_path / "a.mcap", zero))
    assert run.odometry.time_ns[0] == logs.START_NS + 3_000_001
    assert run.source["time"] == "log"
    assert any("no header time" in text for text in run.warnings)
    some = disturbed(logs, lambda k, m: replace(m, stamp_ns=0) if k < 10 else m)
    run = read_run(logs.mcap(tmp_path / "b.mcap", some))
    assert len(run.odometry) == 290
    assert "/odom: 10 messages carry no header time; left out" in run.warnings


def test_a_header_clock_that_goes_back_gives_way_to_log_time(logs, tmp_path):
    def change(k, m):
        return replace(m, stamp_ns=m.stamp_ns - 2 * SECOND) if k >= 150 else m

    run = read_run(logs.mcap(tmp_path / "a.mcap", disturbed(logs, change)))
    assert run.source["time"] == "log"
    assert len(run.odometry) == 300
    assert any("header clock goes back once" in text for text in run.warnings)


def test_a_clock_must_be_known():
    with pytest.raises(Exception, match="--time"):
        ReadSettings(time="sundial")


def stated(logs, sigma_m, topic="/amcl_pose"):
    """The sample drive with poses that state their sigma, by their number."""

    def change(k, m):
        kind = {"topic": topic, "type_name": logs.POSE_COVARIANCE, "child": ""}
        return replace(m, **kind, sigma_m=sigma_m(k))

    return disturbed(logs, change)


@pytest.mark.parametrize("sigma_m", [0.1, 0.0, -1.0, float("nan"), 50.0])
def test_poses_with_a_covariance_are_odometry_like_any_other(logs, tmp_path, sigma_m):
    plain = read_run(logs.mcap(tmp_path / "plain.mcap", logs.drive()))
    for log in (
        logs.mcap(tmp_path / "a.mcap", stated(logs, lambda k: sigma_m)),
        logs.bag(tmp_path / "a.bag", stated(logs, lambda k: sigma_m)),
    ):
        run = read_run(log)
        assert run.warnings == ()
        assert run.odometry.pose.tobytes() == plain.odometry.pose.tobytes()
        assert run.source["odometry"] == {
            "topic": "/amcl_pose",
            "type": logs.POSE_COVARIANCE,
            "messages": 300,
        }


def test_where_somebody_put_the_robot_is_no_odometry(logs, tmp_path):
    log = logs.mcap(tmp_path / "a.mcap", stated(logs, lambda k: 0.1, "/initialpose"))
    with pytest.raises(LogError, match="no odometry found"):
        read_run(log)
    named = read_run(log, ReadSettings(odometry_topic="/initialpose"))
    assert len(named.odometry) == 300
