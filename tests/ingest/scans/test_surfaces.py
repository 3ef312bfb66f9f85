"""Lines through neighbouring beams."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.surfaces import surfaces

STEP = np.radians(1.0)
BEARING = np.radians(np.arange(-60, 61))


def kinked(kink_rad: float, away_m: float, noise_m: float = 0.0) -> np.ndarray:
    """(m, 2) points of a wall ahead that turns off by an angle in the middle."""
    normal = np.where(BEARING[:, None] < 0, [1.0, 0.0], [np.cos(kink_rad), np.sin(kink_rad)])
    beams = np.stack([np.cos(BEARING), np.sin(BEARING)], axis=1)
    ranges = away_m * normal[:, 0] / np.sum(normal * beams, axis=1)
    noise = np.random.default_rng(3).normal(0, noise_m, len(BEARING)) if noise_m else 0.0
    return np.asarray(beams * (ranges + noise)[:, None])


@pytest.mark.parametrize("away_m", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("kink_rad", [0.3, 0.8])
def test_at_a_kink_each_beam_is_on_its_own_wall(away_m: float, kink_rad: float) -> None:
    xy = kinked(kink_rad, away_m)
    found = surfaces(xy[None].astype(np.float32), np.array([STEP]))
    # The beam in the middle is on both.
    near = np.r_[50:60, 61:71]
    off = np.hypot(found.x[0] - xy[:, 0], found.y[0] - xy[:, 1])[near]
    assert found.valid[0, near].all()
    assert off.max() < 0.004
    turned = np.arctan2(-found.ny[0], -found.nx[0])[near]
    assert np.abs(turned - np.where(BEARING[near] < 0, 0.0, kink_rad)).max() < 0.05


def test_along_a_wall_both_sides_make_the_line() -> None:
    """Else its direction would be twice as uncertain and more."""
    off = []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0, 0.01, len(BEARING))
        beams = np.stack([np.cos(BEARING), np.sin(BEARING)], axis=1)
        xy = beams * (2.0 / np.cos(BEARING) + noise)[:, None]
        found = surfaces(xy[None].astype(np.float32), np.array([STEP]))
        off.append(np.arctan2(-found.ny[0], -found.nx[0])[60])
    # 21 beams 3.5 cm apart: 0.01 / (0.035 √(21 · 440 / 12)) = 0.0103.
    assert np.std(off) < 1.4 * 0.0103
