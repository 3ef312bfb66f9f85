"""What is stated of matched poses, against how far off they are when a drive is repeated."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.alignment import Aligned, AlignmentSettings, Steps, align
from topobatch.ingest.scans.association import Swept
from topobatch.topology.se2 import between, wrap

from .building import WHOLE_TURN, Building

SETTINGS = AlignmentSettings(offsets=(1, 2, 4, 8))
N = 48
HALL = Building.of((0.0, 0.0, 26.0, 3.0), (5.0, 2.9, 7.0, 9.0), (16.0, -6.0, 18.0, 0.1))
REAL = np.column_stack(
    [np.linspace(1.5, 13.5, N), np.full(N, 1.4), 0.3 * np.sin(np.linspace(0, 6, N))]
)
RANGES = HALL.ranges(REAL, WHOLE_TURN)


def swept(noise_m: float, seed: int) -> Swept:
    ranges = RANGES + np.random.default_rng(seed).normal(0, noise_m, RANGES.shape)
    along = np.stack([np.cos(WHOLE_TURN), np.sin(WHOLE_TURN)], axis=-1)
    xy = (ranges[..., None] * along).astype(np.float32)
    step = np.full(N, WHOLE_TURN[1] - WHOLE_TURN[0])
    return Swept.of(xy, np.full(N, WHOLE_TURN[0]), step)


def matched(noise_m: float, seed: int) -> Aligned:
    rng = np.random.default_rng(1000 + seed)
    sigma = np.array([0.01, 0.01, 0.02])
    steps = between(REAL[:-1], REAL[1:]) + rng.normal(0, sigma, (N - 1, 3))
    earlier = [np.arange(N) - k for k in SETTINGS.offsets]
    odometry = Steps(steps, np.tile(np.diag(sigma**-2.0), (N - 1, 1, 1)))
    scans = swept(noise_m, seed)
    return align(scans, REAL, odometry, fixed=1, earlier=earlier, settings=SETTINGS)


def variance(found: Aligned, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Of turns, patches taken as independent."""
    walls, absorbed, odometry, *_ = found.scatter.headings(found.pose, first, last)
    return np.asarray(walls / (1 - absorbed) + odometry)


@pytest.mark.parametrize("noise_m", [0.02])
def test_headings_are_off_as_stated(noise_m: float) -> None:
    first = np.array([4, 10, 16])
    last = first + 28
    off, stated = [], []
    for seed in range(16):
        found = matched(noise_m, seed)
        turned = wrap(found.pose[last, 2] - found.pose[first, 2])
        off.append(wrap(turned - wrap(REAL[last, 2] - REAL[first, 2])))
        stated.append(variance(found, first, last))
    ratio = np.sqrt(np.mean(stated) / np.mean(np.square(off)))
    # Two long walls and four ends, all seen all the time: too few groups for more than that.
    assert 0.8 < ratio < 3.0
