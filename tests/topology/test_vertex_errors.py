"""Samples of the errors of vertices, and what they say of distances."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.vertex_errors import VertexErrors


def test_only_errors_along_the_line_change_a_distance() -> None:
    rng = np.random.default_rng(3)
    sample = rng.normal(0, [[[0.1], [0.3], [0.0]], [[0.0], [0.0], [0.0]]], (2, 3, 4000))
    xy = np.array([[0.0, 0.0], [0.0, 7.0]])
    sigma = VertexErrors(sample).distance_sigma(xy, np.array([0]), np.array([1]))
    assert sigma[0] == pytest.approx(0.3, rel=0.05)


def test_an_error_common_to_all_is_none() -> None:
    shift = np.broadcast_to([[[0.5], [0.2], [0.1]]], (3, 3, 5))
    xy = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0]])
    sigma = VertexErrors(shift).distance_sigma(xy, np.array([0, 1]), np.array([1, 2]))
    np.testing.assert_allclose(sigma, 0.0, atol=1e-12)
