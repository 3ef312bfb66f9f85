"""Heading calibration: known errors are found, absent ones are not invented."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.odometry.calibration import Calibration, apply_calibration, calibrate
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections
from topobatch.topology.se2 import apply, fit_rigid, inverse, wrap

RATE_HZ, SPEED = 20.0, 0.8


def drive(seed: int, legs: int = 50, bend: float = 0.0) -> tuple[Odometry, Detections]:
    """An exact track through a street grid with unequal blocks, and what a good detector sees.

    bend: every corner is off the right angle by a normal angle of this sigma [rad].
    """
    rng = np.random.default_rng(seed)
    heading, corner = 0.3, np.zeros(2)
    corners, out = [corner], []
    for _ in range(legs):
        length = rng.uniform(3, 9)
        corner = corner + length * np.array([np.cos(heading), np.sin(heading)])
        corners.append(corner)
        out.append(heading)
        heading += rng.choice([0, np.pi / 2, -np.pi / 2]) + rng.normal(0, bend)
    path, spacing = [], SPEED / RATE_HZ
    for a, b in itertools.pairwise(corners):
        k = int(np.hypot(*(b - a)) / spacing)
        path.append(a + (b - a) * (np.arange(k) / k)[:, None])
    xy = np.concatenate(path)
    width = 15
    soft = np.pad(xy, ((width, width), (0, 0)), mode="edge")
    xy = np.stack(
        [
            np.convolve(soft[:, k], np.ones(2 * width + 1) / (2 * width + 1), "valid")
            for k in (0, 1)
        ],
        1,
    )
    step = np.diff(xy, axis=0, append=2 * xy[-1:] - xy[-2:-1])
    theta = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    time_ns = (10**18 + np.arange(len(xy)) * 1e9 / RATE_HZ).astype(np.int64)
    odometry = Odometry(time_ns, np.column_stack([xy, wrap(theta)]), np.zeros(0, np.int64))
    times, centres, rows = [], [], []
    for place, (before, after) in enumerate(itertools.pairwise(out), start=1):
        at = np.array(corners[place])
        branches = np.unique(np.round([before + np.pi, after, after + np.pi / 2], 6))
        for row in np.flatnonzero(np.hypot(*(xy - at).T) < 1.0)[::3]:
            pose = odometry.pose[row]
            times.append(time_ns[row])
            centres.append(apply(inverse(pose), at) + rng.normal(0, 0.05, 2))
            rows.append(wrap(branches - pose[2] + rng.normal(0, 0.04, len(branches))))
    order = np.argsort(times, kind="stable")
    detections = Detections(
        np.array(times)[order], np.array(centres)[order], Ragged.from_rows([rows[k] for k in order])
    )
    return odometry, detections


def spoil(
    odometry: Odometry, seed: int, bias: float = 0.0, scale: float = 0.0, lag: float = 0.0
) -> Odometry:
    """Odometry as a robot with these errors and some random walk would have recorded it."""
    rng = np.random.default_rng(seed)
    wrong = apply_calibration(odometry, Calibration(applied=(-bias, -scale, -lag)))
    noise = np.cumsum(rng.normal(0, 0.005, len(odometry)) * np.sqrt(odometry.step_m))
    return replace(wrong, pose=np.column_stack([wrong.pose[:, :2], wrap(wrong.pose[:, 2] + noise)]))


def off(track: Odometry, truth: Odometry) -> float:
    """Rms position error [m] after the best rigid fit, at the times of the truth."""
    xy = track.at(truth.time_ns)[:, :2]
    T = fit_rigid(truth.pose[:, :2], xy)
    return float(np.sqrt(np.mean(np.sum((apply(T, xy) - truth.pose[:, :2]) ** 2, axis=1))))


@pytest.mark.parametrize(
    ("bias", "scale", "lag"),
    [(0.056, 0.0, 0.0), (-0.03, 0.03, 0.0), (0.02, -0.015, 0.2), (0.0, 0.04, -0.15)],
)
def test_known_errors_are_found(bias: float, scale: float, lag: float) -> None:
    truth, detections = drive(0)
    recorded = spoil(truth, 0, bias, scale, lag)
    found = calibrate(recorded, detections)
    error = np.array(found.estimate) - (bias, scale, lag)
    assert np.all(np.abs(error) < 4 * np.array(found.sigma)), (found, error)
    assert np.all(np.abs(error) < (0.004, 0.008, 0.04))
    assert all(
        applied for applied, value in zip(found.applied, (bias, scale, lag), strict=True) if value
    )
    assert off(apply_calibration(recorded, found), truth) < 0.25 * off(recorded, truth) + 0.3


@pytest.mark.parametrize("bend", [0.0, 0.5])
def test_where_there_is_no_error_none_is_taken_out(bend: float) -> None:
    truth, detections = drive(0, legs=40, bend=bend)
    recorded = spoil(truth, 0)
    found = calibrate(recorded, detections)
    assert off(apply_calibration(recorded, found), truth) < off(recorded, truth) + 0.15


def test_result_does_not_depend_on_the_frame() -> None:
    truth, detections = drive(2, legs=30)
    recorded = spoil(truth, 2, bias=0.04)
    c, s = np.cos(1.0), np.sin(1.0)
    x, y, theta = recorded.pose.T
    turned = replace(
        recorded, pose=np.column_stack([c * x - s * y + 5, s * x + c * y, wrap(theta + 1.0)])
    )
    here, there = calibrate(recorded, detections), calibrate(turned, detections)
    np.testing.assert_allclose(here.applied, there.applied, atol=1e-4)


def test_a_real_robot_is_straightened() -> None:
    scenario = simulate_scenario(
        ScenarioSettings("maze", 1, junctions_per_run=50, drift="real", faults="mild", seed=1)
    )
    run, truth = scenario.runs["run1"], scenario.truth.runs["run1"]
    true = Odometry(truth.path_ns, truth.path, np.zeros(0, np.int64))
    found = calibrate(run.odometry, run.detections)
    assert found.applied[0] == pytest.approx(np.radians(1.5), abs=np.radians(0.25))
    assert off(apply_calibration(run.odometry, found), true) < 0.4 * off(run.odometry, true)
