"""The noise of a run from its own closed estimate, of runs whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.manhattan import grid_corridors, grid_headings
from topobatch.topology.closure.variance_components import fitted_noise, with_shown_spread
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
