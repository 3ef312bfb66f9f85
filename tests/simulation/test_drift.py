"""Odometry that errs as it is told to."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.simulation.scenario import simulate_run
from topobatch.simulation.worlds import make_world
from topobatch.topology.se2 import between, compose, wrap

from .driven import PERFECT, drifted


def test_without_drift_odometry_is_the_true_path() -> None:
    simulated = simulate_run(make_world("organic", 40, 1), settings=PERFECT, seed=1)
    poses = compose(
        simulated.truth.T_world_odom, simulated.run.odometry.at(simulated.truth.path_ns)
    )
    off = poses - simulated.truth.path
    assert np.max(np.hypot(off[:, 0], off[:, 1])) < 0.01
    assert np.max(np.abs(wrap(off[:, 2]))) < 1e-3


def test_a_reset_starts_again_from_zero_and_breaks_the_track() -> None:
    broken = drifted(resets_per_100_m=1.0)
    odometry = broken.run.odometry
    assert len(odometry.breaks) >= 1
    np.testing.assert_array_equal(odometry.pose[odometry.breaks], 0.0)
    assert odometry.time_ns[odometry.breaks].tolist() == list(broken.truth.break_ns)
    assert odometry.step_m.sum() == pytest.approx(drifted().run.odometry.step_m.sum(), rel=1e-3)


def test_the_frame_jumps_where_the_truth_says_and_as_far() -> None:
    plain, struck = drifted(), drifted(jumps=2, jump_m=0.7, jump_deg=40.0)
    seen, true = struck.run.odometry, plain.run.odometry
    rows = np.searchsorted(seen.time_ns, struck.truth.jump_ns)
    assert len(rows) == 2
    step = between(seen.pose[rows - 1], seen.pose[rows])
    off = step - between(true.pose[rows - 1], true.pose[rows])
    np.testing.assert_allclose(np.hypot(off[:, 0], off[:, 1]), 0.7, atol=1e-3)
    np.testing.assert_allclose(np.abs(np.degrees(off[:, 2])), 40.0, atol=1e-2)
    others = np.delete(np.arange(1, len(seen)), rows - 1)
    turned = wrap(seen.turn_rad - true.turn_rad)[others]
    np.testing.assert_allclose(turned, 0.0, atol=1e-3)
    assert struck.truth.vertex.tolist() == plain.truth.vertex.tolist()
