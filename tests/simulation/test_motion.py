"""How robots drive."""

from __future__ import annotations

import numpy as np

from topobatch.simulation.scenario import simulate_run
from topobatch.simulation.worlds import make_world
from topobatch.topology.se2 import wrap

from .driven import PERFECT


def test_speeds_are_those_of_the_poses() -> None:
    simulated = simulate_run(make_world("maze", 30, 2), settings=PERFECT, seed=1)
    odometry = simulated.run.odometry
    period = np.diff(odometry.time_ns) * 1e-9
    turning = wrap(np.diff(odometry.pose[:, 2])) / period
    np.testing.assert_allclose(turning, simulated.twist[:-1, 1], atol=2e-3)
    assert np.max(np.abs(simulated.twist[:, 0])) < 1.5
