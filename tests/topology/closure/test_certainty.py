"""How far places may be off, from samples of all their errors."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.certainty import place_errors
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.topomap import RunNoise

from .walks import EXACT, noisy_square


def test_places_seen_once_are_as_far_off_as_their_detection() -> None:
    exact = RunNoise(1e-5, 1e-5, 1e-5, 0.0, 0.05, 0.02)
    odometry, passes, place = noisy_square(1, exact, 2)
    reckoning = dead_reckoning(odometry, passes, exact, EXACT)
    alone = np.arange(len(place))
    errors = place_errors(reckoning, optimise(reckoning, alone), alone, alone)
    sigma = errors.distance_sigma(passes.centre, np.array([0, 1]), np.array([4, 3]))
    np.testing.assert_allclose(sigma, 0.05 * np.sqrt(2), rtol=0.15)


def test_what_is_drawn_is_as_large_as_stated() -> None:
    odometry, passes, place = noisy_square(1, RunNoise(1e-5, 1e-5, 1e-5, 0.0, 0.05, 0.02), 2)
    alone, middle = np.arange(len(place)), passes.centre.mean(axis=0)
    for scale, centre, rms in ((0.0, 0.05, 0.05), (0.01, 0.001, 0.01 * (passes.centre - middle))):
        exact = RunNoise(1e-6, 1e-6, 1e-6, scale, centre, 0.02)
        reckoning = dead_reckoning(odometry, passes, exact, EXACT)
        error = place_errors(reckoning, optimise(reckoning, alone), alone, alone).sample[:, :2]
        found = np.sqrt(np.mean(error**2, axis=2))
        np.testing.assert_allclose(found, np.abs(rms) + 0 * found, rtol=0.01, atol=0.002)


def test_readings_turn_no_place_that_the_odometry_holds() -> None:
    exact = RunNoise(1e-5, 1e-5, 1e-5, 0.0, 0.02, 0.03)
    odometry, passes, place = noisy_square(2, exact, 3)
    reckoning = dead_reckoning(odometry, passes, exact, EXACT)
    errors = place_errors(reckoning, optimise(reckoning, place), place, np.arange(8))
    xy = np.stack([passes.centre[place == k].mean(axis=0) for k in range(8)])
    assert errors.as_a_whole(xy, np.zeros(8, int)).turn_sigma().max() < 0.1 * 0.03


def test_what_all_passes_share_no_number_of_them_takes_off() -> None:
    exact = RunNoise(1e-5, 1e-5, 1e-5, 0.0, 0.001, 0.03)
    odometry, passes, place = noisy_square(3, exact, 3)
    reckoning = dead_reckoning(odometry, passes, exact, EXACT)
    assert np.bincount(place).min() > 1
    shared = np.where(place == 4, 0.2, 0.1)
    errors = place_errors(
        reckoning, optimise(reckoning, place), place, np.arange(8), shared_m=shared
    )
    xy = np.stack([passes.centre[place == k].mean(axis=0) for k in range(8)])
    sigma = errors.distance_sigma(xy, np.array([0, 0]), np.array([1, 4]))
    np.testing.assert_allclose(sigma, np.hypot(0.1, [0.1, 0.2]), rtol=0.15)
