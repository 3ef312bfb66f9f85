"""The noise of a run from its own closed estimate, of runs whose noise is known."""

from __future__ import annotations

import pytest

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.variance_components import fitted_noise
from topobatch.topology.topomap import RunNoise

from .walks import noisy_square


def test_loops_tell_each_kind_of_noise() -> None:
    true = RunNoise(0.02, 0.01, 0.02, 0.0, 0.06, 0.03)
    odometry, passes, place = noisy_square(15, true, 4)
    start = RunNoise(0.03, 0.015, 0.03, 0.0, 0.09, 0.045)
    reckoning = dead_reckoning(odometry, passes, start)
    fitted = fitted_noise(reckoning, odometry, place, optimise(reckoning, place))
    noise = fitted.reckoning.noise
    assert noise.centre_m == pytest.approx(0.06, rel=0.2)
    assert noise.branch_rad == pytest.approx(0.03, rel=0.2)
    assert noise.heading_rad_per_sqrt_m == pytest.approx(0.01, rel=0.4)
    assert fitted.estimate.reduced_chi2 == pytest.approx(1.0, abs=0.25)
