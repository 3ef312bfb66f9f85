"""How far places may be off, from samples of all their errors."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.certainty import place_errors
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.topomap import RunNoise

from .walks import noisy_square


def test_what_is_drawn_is_as_large_as_stated() -> None:
    odometry, passes, place = noisy_square(1, RunNoise(1e-5, 1e-5, 1e-5, 0.0, 0.05, 0.02), 2)
    alone, middle = np.arange(len(place)), passes.centre.mean(axis=0)
    for scale, centre, rms in ((0.0, 0.05, 0.05), (0.01, 0.001, 0.01 * (passes.centre - middle))):
        exact = RunNoise(1e-6, 1e-6, 1e-6, scale, centre, 0.02)
        reckoning = dead_reckoning(odometry, passes, exact)
        error = place_errors(reckoning, optimise(reckoning, alone), alone, alone).sample[:, :2]
        found = np.sqrt(np.mean(error**2, axis=2))
        np.testing.assert_allclose(found, np.abs(rms) + 0 * found, rtol=0.01, atol=0.002)
