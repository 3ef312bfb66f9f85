"""How robots drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.simulation import make_world, simulate_run
from topobatch.topology.se2 import compose, wrap

from .driven import PERFECT


def test_speeds_are_those_of_the_poses() -> None:
    simulated = simulate_run(make_world("maze", 30, 2), settings=PERFECT, seed=1)
    odometry = simulated.run.odometry
    period = np.diff(odometry.time_ns) * 1e-9
    turning = wrap(np.diff(odometry.pose[:, 2])) / period
    np.testing.assert_allclose(turning, simulated.twist[:-1, 1], atol=2e-3)
    assert np.max(np.abs(simulated.twist[:, 0])) < 1.5


def test_turning_back_is_driven_but_no_corridor() -> None:
    world = make_world("maze", 60, 4)
    faults = replace(PERFECT.faults, turn_back_rate=0.5)
    back = simulate_run(world, settings=replace(PERFECT, faults=faults), seed=2)
    straight = simulate_run(world, settings=PERFECT, seed=2)
    assert back.run.odometry.step_m.sum() > 1.1 * straight.run.odometry.step_m.sum()
    np.testing.assert_array_equal(back.truth.drive_edge, straight.truth.drive_edge)
    off = compose(back.truth.T_world_odom, back.run.odometry.at(back.truth.path_ns))
    assert np.max(np.hypot(*(off - back.truth.path)[:, :2].T)) < 0.01
