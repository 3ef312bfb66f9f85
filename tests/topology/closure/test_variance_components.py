"""The noise of a run from its own closed estimate, of runs whose noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.manhattan import GridHeadings, grid_corridors, grid_headings
from topobatch.topology.closure.variance_components import fitted_noise, with_shown_spread
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import RunNoise

from .walks import EXACT, NOISE, aisles, noisy_square, partition, record, to_and_fro


def test_loops_tell_each_kind_of_noise() -> None:
    true = RunNoise(0.02, 0.01, 0.02, 0.0, 0.06, 0.03)
    odometry, passes, place = noisy_square(15, true, 4)
    start = RunNoise(0.03, 0.015, 0.03, 0.0, 0.09, 0.045)
    reckoning = dead_reckoning(odometry, passes, start, EXACT)
    fitted = fitted_noise(reckoning, odometry, place, optimise(reckoning, place))
    noise = fitted.reckoning.noise
    assert noise.centre_m == pytest.approx(0.06, rel=0.2)
    assert noise.branch_rad == pytest.approx(0.03, rel=0.2)
    assert noise.heading_rad_per_sqrt_m == pytest.approx(0.01, rel=0.4)
    assert fitted.estimate.reduced_chi2 == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
def test_means_over_passes_walk_less_than_headings() -> None:
    true = RunNoise(0.005, 0.02, 1e-4, 0.0, 0.03, 0.01)
    found = []
    for seed in range(6):
        odometry, passes, place = noisy_square(20, true, seed)
        # Each branch as the mean of five readings on 2 m of way around the junction.
        at = np.searchsorted(odometry.time_ns, passes.time_ns)
        window = np.clip(at[:, None] + np.arange(-2, 3), 0, len(odometry) - 1)
        off = odometry.pose[:, 2] - np.pi / 2 * (np.arange(len(odometry)) // (at[2] - at[0]))
        moved = (off[window].mean(axis=1) - off[at])[passes.branches.owner]
        begin, end = odometry.time_ns[window[:, [0, -1]]].T
        smoothed = replace(
            passes,
            start_ns=begin,
            end_ns=end,
            branches=Ragged(passes.branches.offsets, passes.branches.values + moved),
            messages=np.full(len(passes), 5),
        )
        reckoning = dead_reckoning(odometry, smoothed, true, EXACT)
        fitted = fitted_noise(reckoning, odometry, place, optimise(reckoning, place))
        found.append(fitted.reckoning.noise.heading_rad_per_sqrt_m**2)
    # Taken for headings at the junctions, they would tell of a tenth less.
    assert np.mean(found) == pytest.approx(0.02**2, rel=0.06)


def test_noise_that_is_not_there_is_not_stated() -> None:
    exact = RunNoise(0.0, 0.0, 0.0, 0.0, 0.06, 0.03)
    odometry, passes, place = noisy_square(10, exact, 5)
    start = RunNoise(0.01, 0.005, 0.01, 0.0, 0.06, 0.03)
    reckoning = dead_reckoning(odometry, passes, start, EXACT)
    noise = fitted_noise(reckoning, odometry, place, optimise(reckoning, place)).reckoning.noise
    for name in ("along_m_per_sqrt_m", "heading_rad_per_sqrt_m", "heading_rad_per_sqrt_rad"):
        assert getattr(noise, name) < 0.1 * getattr(start, name)
    assert noise.centre_m == pytest.approx(0.06, rel=0.2)


def test_random_walks_that_do_for_each_other_keep_to_each_other() -> None:
    true = RunNoise(0.005, 0.0035, 0.005, 0.0, 0.06, 0.03)
    odometry, passes, place = noisy_square(3, true, 4)
    start = RunNoise(0.01, 0.007, 0.01, 0.0, 0.06, 0.03)
    reckoning = dead_reckoning(odometry, passes, start, EXACT)
    noise = fitted_noise(reckoning, odometry, place, optimise(reckoning, place)).reckoning.noise
    # A heading that drifts by the way or by its turns is hardly told apart: neither is none.
    for name in ("along_m_per_sqrt_m", "heading_rad_per_sqrt_m", "heading_rad_per_sqrt_rad"):
        assert 2 / 3 < getattr(noise, name) / getattr(true, name) < 1.5


def test_a_grid_that_bends_is_none() -> None:
    true = RunNoise(0.01, 0.01, 0.01, 0.0, 0.05, 0.03)
    odometry, passes, place = noisy_square(10, true, 6)
    reckoning, row = dead_reckoning(odometry, passes, true, EXACT), np.arange(len(passes))
    estimate = optimise(reckoning, place)
    bend = 0.3 * np.sin(np.pi * (place % 8) / 4)
    for bent, holds in ((bend, False), (0 * bend, True)):
        sigma = np.full(len(row), 0.03)
        turn, axis = estimate.pose[:, 2] + bent, np.zeros(len(row))
        grid = GridHeadings(row, turn, axis, sigma, spread_rad=0.02)
        fitted = fitted_noise(reckoning, odometry, place, estimate, grid=grid)
        assert (fitted.grid is not None) == holds


def test_without_loops_nothing_changes() -> None:
    start = RunNoise(0.01, 0.02, 0.01, 0.0, 0.1, 0.05)
    odometry, passes, _ = noisy_square(2, start, 1)
    reckoning, alone = dead_reckoning(odometry, passes, start, EXACT), np.arange(len(passes))
    fitted = fitted_noise(reckoning, odometry, alone, optimise(reckoning, alone)).reckoning.noise
    for name in ("along_m_per_sqrt_m", "heading_rad_per_sqrt_m", "centre_m", "branch_rad"):
        assert getattr(fitted, name) == pytest.approx(getattr(start, name), rel=0.1)


@pytest.mark.slow
def test_what_a_kernel_holds_down_is_counted() -> None:
    true = RunNoise(0.01, 0.003, 0.003, 0.0, 0.06, 0.03)
    found = []
    for seed in range(3):
        odometry, passes, place = noisy_square(80, true, seed)
        reckoning = dead_reckoning(odometry, passes, true, EXACT)
        fitted = fitted_noise(reckoning, odometry, place, optimise(reckoning, place))
        assert np.isfinite(fitted.estimate.graph.kernel).any()
        found.append(fitted.reckoning.noise.centre_m)
    # Cauchy weights alone would leave less of it.
    assert np.mean(found) == pytest.approx(0.06, rel=0.06)


@pytest.mark.parametrize(("aslant", "least", "most"), [(0.0, 0.0, 0.015), (0.05, 0.03, 0.08)])
def test_corridors_are_held_as_straight_as_loops_show_them(aslant, least, most):
    rng = np.random.default_rng(32)
    world = aisles(14, aslant=aslant * rng.normal(size=14))
    odometry, passes, truth = record(world, to_and_fro(14), rng)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    grid = grid_headings(reckoning)
    turn = optimise(reckoning, partition(truth), grid=grid).pose[:, 2]
    corridors = grid_corridors(reckoning, grid, turn, 3.0)
    for _ in range(3):
        estimate = optimise(reckoning, partition(truth), grid=grid, corridors=corridors)
        corridors = with_shown_spread(corridors, estimate, grid)
    across, along = (corridors.spread_rad[corridors.side == k] for k in (0, 1))
    assert least < along.min() == along.max() < most
    # What crosses the aisles is straight, however these are.
    assert across.min() == across.max() < 0.02
