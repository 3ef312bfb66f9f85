"""Which beam looks towards a point."""

from __future__ import annotations

import numpy as np

from topobatch.ingest.scans.association import bearings


def test_bearings_are_arctangents() -> None:
    angle = np.linspace(-np.pi, np.pi, 100_001)
    for away_m in (1e-3, 1.0, 1e4):
        x, y = ((away_m * of(angle)).astype(np.float32) for of in (np.cos, np.sin))
        off = bearings(x, y) - np.arctan2(y, x, dtype=np.float64)
        assert np.abs(off).max() < 1.2e-5


def test_bearings_along_the_axes_and_of_no_direction() -> None:
    x, y = np.array([[1, 0, -1, -1, 0, 0], [0, 1, 0.0, -0.0, -1, 0]], np.float32)
    expected = np.array([0, np.pi / 2, np.pi, -np.pi, -np.pi / 2, 0])
    np.testing.assert_allclose(bearings(x, y), expected, atol=1e-6)
