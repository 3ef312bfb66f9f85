"""The noise of a walk from its own closed layout, on walks whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.closure.certainty import place_errors
from topobatch.topology.closure.dead_reckoning import SystematicErrors, make_walk
from topobatch.topology.closure.estimate import lay_out
from topobatch.topology.closure.manhattan import GridHeadings
from topobatch.topology.closure.variance_components import fitted_noise
from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import NO_BRANCH, Passes
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import RunNoise

EVERY = 16
"""Odometry rows from one pass to the next, at half a metre each."""
EXACT = SystematicErrors(1e-6, 1e-6)


def noisy_square(laps: int, noise: RunNoise, seed: int) -> tuple[Odometry, Passes, np.ndarray]:
    """Laps round a square of eight junctions, 8 m apart, with errors of exactly that noise."""
    rng = np.random.default_rng(seed)
    count = 8 * EVERY * laps + 1
    row = np.arange(count)
    heading = np.pi / 2 * (row // (2 * EVERY))
    turned = np.concatenate([[0.0], np.diff(heading)])
    way = np.full(count, 0.5)
    spread = noise.heading_rad_per_sqrt_m**2 * way + noise.heading_rad_per_sqrt_rad**2 * turned
    off = np.cumsum(rng.normal(0, np.sqrt(spread)))
    step = 0.5 * np.column_stack([np.cos(heading + off), np.sin(heading + off)])
    step += rng.normal(0, noise.along_m_per_sqrt_m * np.sqrt(0.5), step.shape)
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)[:-1]])
    pose = np.column_stack([xy, heading + off])
    odometry = Odometry(row * 10**8, pose, np.zeros(0, np.int64))
    at = row[::EVERY]
    p = len(at)
    rows = [off[k] + np.array([0.0, np.pi / 2, np.pi]) for k in at]
    branches = Ragged.from_rows(rows)
    read = Ragged(branches.offsets, branches.values + rng.normal(0, noise.branch_rad, 3 * p))
    unknown, when = np.full(p, NO_BRANCH), odometry.time_ns[at]
    centre = xy[at] + rng.normal(0, noise.centre_m, (p, 2))
    full = Ragged(read.offsets, np.ones(3 * p))
    passes = Passes(
        when, when, when, centre, read, full, unknown, unknown, np.ones(p, int), np.ones(p)
    )
    return odometry, passes, np.arange(p) % 8


def test_loops_tell_each_kind_of_noise() -> None:
    true = RunNoise(0.02, 0.01, 0.02, 0.0, 0.06, 0.03)
    odometry, passes, place = noisy_square(15, true, 4)
    start = RunNoise(0.03, 0.015, 0.03, 0.0, 0.09, 0.045)
    walk = make_walk(odometry, passes, start, EXACT)
    fitted = fitted_noise(walk, odometry, place, lay_out(walk, place))
    noise = fitted.walk.noise
    assert noise.centre_m == pytest.approx(0.06, rel=0.2)
    assert noise.branch_rad == pytest.approx(0.03, rel=0.2)
    assert noise.heading_rad_per_sqrt_m == pytest.approx(0.01, rel=0.4)
    assert fitted.layout.misfit == pytest.approx(1.0, abs=0.25)


def test_noise_that_is_not_there_is_not_stated() -> None:
    exact = RunNoise(0.0, 0.0, 0.0, 0.0, 0.06, 0.03)
    odometry, passes, place = noisy_square(10, exact, 5)
    start = RunNoise(0.01, 0.005, 0.01, 0.0, 0.06, 0.03)
    walk = make_walk(odometry, passes, start, EXACT)
    noise = fitted_noise(walk, odometry, place, lay_out(walk, place)).walk.noise
    for name in ("along_m_per_sqrt_m", "heading_rad_per_sqrt_m", "heading_rad_per_sqrt_rad"):
        assert getattr(noise, name) < 0.2 * getattr(start, name)
    assert noise.centre_m == pytest.approx(0.06, rel=0.2)


def test_a_grid_that_bends_is_none() -> None:
    true = RunNoise(0.01, 0.01, 0.01, 0.0, 0.05, 0.03)
    odometry, passes, place = noisy_square(10, true, 6)
    walk, row = make_walk(odometry, passes, true, EXACT), np.arange(len(passes))
    layout = lay_out(walk, place)
    bend = 0.3 * np.sin(np.pi * (place % 8) / 4)
    for bent, holds in ((bend, False), (0 * bend, True)):
        sigma = np.full(len(row), 0.03)
        turn, axis = layout.pose[:, 2] + bent, np.zeros(len(row))
        grid = GridHeadings(row, turn, axis, sigma, wander=1.0, spread_rad=0.02)
        fitted = fitted_noise(walk, odometry, place, layout, grid=grid)
        assert (fitted.grid is not None) == holds


def test_without_loops_nothing_changes() -> None:
    start = RunNoise(0.01, 0.02, 0.01, 0.0, 0.1, 0.05)
    odometry, passes, _ = noisy_square(2, start, 1)
    walk, alone = make_walk(odometry, passes, start, EXACT), np.arange(len(passes))
    fitted = fitted_noise(walk, odometry, alone, lay_out(walk, alone)).walk.noise
    for name in ("along_m_per_sqrt_m", "heading_rad_per_sqrt_m", "centre_m", "branch_rad"):
        assert getattr(fitted, name) == pytest.approx(getattr(start, name), rel=0.1)


def test_places_seen_once_are_as_far_off_as_their_detection() -> None:
    exact = RunNoise(1e-5, 1e-5, 1e-5, 0.0, 0.05, 0.02)
    odometry, passes, place = noisy_square(1, exact, 2)
    walk = make_walk(odometry, passes, exact, EXACT)
    alone = np.arange(len(place))
    errors = place_errors(walk, lay_out(walk, alone), alone, alone)
    sigma = errors.distance_sigma(passes.centre, np.array([0, 1]), np.array([4, 3]))
    np.testing.assert_allclose(sigma, 0.05 * np.sqrt(2), rtol=0.15)


def test_what_a_kernel_holds_down_is_counted() -> None:
    true = RunNoise(0.01, 0.003, 0.003, 0.0, 0.06, 0.03)
    found = []
    for seed in range(3):
        odometry, passes, place = noisy_square(80, true, seed)
        walk = make_walk(odometry, passes, true, EXACT)
        fitted = fitted_noise(walk, odometry, place, lay_out(walk, place))
        assert np.isfinite(fitted.layout.graph.kernel).any()
        found.append(fitted.walk.noise.centre_m)
    # Cauchy weights alone would leave less of it.
    assert np.mean(found) == pytest.approx(0.06, rel=0.06)


def test_readings_turn_no_place_that_the_odometry_holds() -> None:
    exact = RunNoise(1e-5, 1e-5, 1e-5, 0.0, 0.02, 0.03)
    odometry, passes, place = noisy_square(2, exact, 3)
    walk = make_walk(odometry, passes, exact, EXACT)
    errors = place_errors(walk, lay_out(walk, place), place, np.arange(8))
    xy = np.stack([passes.centre[place == k].mean(axis=0) for k in range(8)])
    assert errors.as_a_whole(xy, np.zeros(8, int)).turn_sigma().max() < 0.1 * 0.03
