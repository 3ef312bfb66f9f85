"""What is stated of matched poses, against how far off they are when a drive is repeated."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from scipy.linalg import solveh_banded

from topobatch.ingest.scans.alignment import Aligned, AlignmentSettings, Steps, align
from topobatch.ingest.scans.association import Swept
from topobatch.ingest.scans.scatter import (
    PATCH_M,
    STRETCH,
    Scores,
    motion_by_ends,
    odometry_scores,
    wall_scores,
)
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
    turns = found.scatter.headings(found.pose, first, last)
    return np.asarray(turns.walls / (1 - turns.absorbed) + turns.odometry)


@pytest.mark.parametrize("noise_m", [0.01, 0.03])
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


def test_twice_the_noise_is_twice_as_uncertain() -> None:
    first, last = np.array([4, 10, 16]), np.array([32, 38, 44])
    quiet, loud = (
        np.mean([np.mean(_headings(noise_m, seed, first, last)) for seed in range(4)])
        for noise_m in (0.015, 0.03)
    )
    assert np.sqrt(loud / quiet) == pytest.approx(2.0, rel=0.4)


def _headings(noise_m: float, seed: int, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    found = matched(noise_m, seed)
    return variance(found, first, last)


def test_ways_are_told_worse_where_walls_are_bare() -> None:
    found = matched(0.01, 0)
    first = np.array([0, 20])
    near, far = (found.scatter.ways(found.pose, first, first + k) for k in (4, 24))
    assert (far > near).all()
    assert (near > 0).all()


def test_what_groups_ask_for_is_summed_up_as_one_by_one() -> None:
    found = matched(0.02, 3)
    scatter, pose = found.scatter, found.pose
    told = scatter.headings(pose, np.array([6]), np.array([30]))
    onto = np.zeros((3 * N, 1))
    onto[3 * 30 + 2], onto[3 * 6 + 2] = 1.0, -1.0
    moved = solveh_banded(scatter.curvature, onto, lower=True).reshape(N, 3)

    def asked(scores: Scores) -> dict[int, float]:
        out: dict[int, float] = defaultdict(float)
        for i, j, group, gradient in zip(
            scores.first, scores.second, scores.group, scores.gradient, strict=True
        ):
            by_first, by_second = motion_by_ends(pose, np.array([i]), np.array([j]))
            out[int(group)] += float(gradient @ (by_first[0] @ moved[i] + by_second[0] @ moved[j]))
        return out

    ahead, back = asked(scatter.walls), asked(scatter.back)
    assert told.walls[0] == pytest.approx(sum(x**2 for x in ahead.values()))
    assert told.odometry[0] == pytest.approx(sum(x**2 for x in asked(scatter.odometry).values()))
    apart = [back.get(k, 0.0) - ahead.get(k, 0.0) for k in set(ahead) | set(back)]
    assert told.apart[0] == pytest.approx(sum(apart) ** 2)
    assert told.apart_alone[0] == pytest.approx(sum(x**2 for x in apart))


def test_groups_are_patches_of_wall_and_stretches_of_odometry() -> None:
    pairs = np.array([3, 4]), np.array([2, 2])
    scores, curvature = wall_scores(swept(0.0, 0), REAL, pairs, SETTINGS.joint_rounds[-1][1], 1.0)
    again = set(scores.group[scores.first == 3]) & set(scores.group[scores.first == 4])
    assert len(again) > 0.7 * len(set(scores.group))
    assert len(set(scores.group)) > 12 / PATCH_M
    assert 0.9 < curvature <= 1.0
    odometry = odometry_scores(np.ones((2 * STRETCH, 3)))
    assert np.bincount(odometry.group).tolist() == [STRETCH, STRETCH]
