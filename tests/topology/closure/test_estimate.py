"""Layout by the pose graph: what its factors are made of."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.estimate import _information


def test_information_is_the_inverse_where_doubles_can_tell():
    spread = np.random.default_rng(0).normal(size=(20, 3, 3))
    cov = spread @ spread.transpose(0, 2, 1) + 1e-3 * np.eye(3)
    np.testing.assert_allclose(_information(cov) @ cov, np.tile(np.eye(3), (20, 1, 1)), atol=1e-8)


def test_information_of_a_leap_is_symmetric_and_positive():
    away = np.array([3.0, -9e5, 1.0])
    cov = np.stack([1e4 * np.outer(away, away), np.eye(3)]) + np.diag([1e-6, 1e-6, 1e-8])
    information = _information(cov)
    np.testing.assert_array_equal(information[0], information[0].T)
    assert np.linalg.eigvalsh(information[0])[0] >= 0
    assert not np.allclose(np.linalg.inv(cov[0]), np.linalg.inv(cov[0]).T, rtol=1e-6, atol=1e-9)
