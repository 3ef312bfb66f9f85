"""Sensitivities of legs against re-integration of the track."""

from __future__ import annotations

import numpy as np

from topobatch.ingest.calibration import Calibration, apply_calibration
from topobatch.topology.heading_drift import leg_sensitivity
from topobatch.topology.odometry import Odometry
from topobatch.topology.se2 import between, wrap


def test_matches_reintegration() -> None:
    rng = np.random.default_rng(0)
    n = 400
    theta = np.cumsum(rng.normal(0, 0.1, n))
    step = 0.05 * np.exp(1j * theta)
    at = 100 + np.cumsum(step)
    odometry = Odometry(
        10**18 + np.arange(n) * 50_000_000,
        np.column_stack([at.real, at.imag, wrap(theta)]),
        np.zeros(0, np.int64),
    )
    a, b = odometry.time_ns[[3, 50, 399, 10]], odometry.time_ns[[120, 399, 0, 10]]
    sensitivity = leg_sensitivity(odometry, a, b)
    for k, size in ((0, 1e-4), (1, 1e-4)):
        applied = [0.0, 0.0, 0.0]
        applied[k] = size
        moved = apply_calibration(odometry, Calibration(applied=tuple(applied)))
        before = between(odometry.at(a), odometry.at(b))
        after = between(moved.at(a), moved.at(b))
        change = (after - before) / size
        change[:, 2] = wrap(after[:, 2] - before[:, 2]) / size
        np.testing.assert_allclose(sensitivity[:, :, k], change, rtol=0.02, atol=0.1)
        np.testing.assert_allclose(sensitivity[3], 0, atol=1e-9)
