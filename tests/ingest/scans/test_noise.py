"""What the noise of scan-matched odometry means in metres."""

import numpy as np
import pytest

from topobatch.ingest.scans.noise import HALF, expected_drift
from topobatch.topology.topomap import RunNoise

NOISE = RunNoise(
    along_m_per_sqrt_m=0.03, heading_rad_per_sqrt_m=0.01, heading_rad_per_sqrt_rad=0.02
)


def circle(turns: float, radius: float, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Poses on a circle, far from the origin, and the way so far."""
    t = np.linspace(0, 2 * np.pi * turns, n)
    xy = 500 + radius * np.stack([np.sin(t), -np.cos(t)], axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    return np.column_stack([xy, t]), way


def test_round_a_bend_as_many_drives_say() -> None:
    pose, way = circle(0.6, 5.0)
    rng = np.random.default_rng(4)
    step, turn = np.diff(way), np.diff(pose[:, 2])
    sigma = np.sqrt(0.01**2 * step + 0.02**2 * turn)
    ahead = step + rng.normal(0, 0.03, (2000, len(step))) * np.sqrt(step)
    heading = pose[:-1, 2] + turn / 2
    heading = heading + np.cumsum(rng.normal(0, 1, (2000, len(step))) * sigma, axis=1)
    end = np.stack([(ahead * f(heading)).sum(axis=1) for f in (np.cos, np.sin)], axis=1)
    real = np.stack([(step * f(pose[:-1, 2] + turn / 2)).sum() for f in (np.cos, np.sin)])
    spread = np.sqrt(np.sum((end - real) ** 2, axis=1).mean())
    assert expected_drift(NOISE, pose, way, way[-1] - 1e-9) == pytest.approx(
        HALF * spread, rel=0.06
    )
