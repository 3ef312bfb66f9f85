"""A robot that was carried while its wheels stood: found by what it sees next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.ingest.reading import read_run


def carried_run(logs, noise=0.0):
    """The robot stands from message 100 to 200 and, from 150 on, sees a junction elsewhere."""
    rng = np.random.default_rng(3)
    out = []
    for k, message in enumerate(logs.drive(300, 2)):
        if message.topic == "/odom":
            number = k * 2 // 3
            still = number if number < 100 else max(100, number - 100)
            pose = logs.yaw_pose(0.02 * still, 0.0, 0.0)
            out.append(replace(message, poses=(pose,)))
        else:
            x, y = (0.5, 0.1) if k * 2 // 3 < 150 else (-1.5, 0.8)
            x, y = x + rng.normal(0, noise), y + rng.normal(0, noise)
            poses = tuple(logs.yaw_pose(x, y, 1.0 * b) for b in range(3))
            out.append(replace(message, poses=poses))
    return out


def test_a_robot_that_was_carried_while_its_wheels_stood(logs, tmp_path):
    run = read_run(logs.mcap(tmp_path / "a.mcap", carried_run(logs, 0.05)))
    assert len(run.odometry.breaks) == 1
    assert abs(int(run.odometry.breaks[0]) - 150) <= 2
    assert any("carried" in text for text in run.warnings)
