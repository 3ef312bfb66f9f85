"""Maps that repeat by steps."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.lattice import lattice_of
from topobatch.topology.closure.places import tabulate

from .walks import NOISE, aisles, partition, record


def test_a_lattice_is_found_by_its_steps():
    odometry, passes, truth = record(aisles(8), [(0, c) for c in range(8)] + [(1, 7), (1, 6)])
    reckoning = dead_reckoning(odometry, passes, NOISE)
    place = partition(truth)
    estimate = optimise(reckoning, place)
    places = tabulate(reckoning, place, estimate.pose[:, 2])
    lattice = lattice_of(places, estimate.xy, core_m=2.0, typical_m=3.0)
    order = np.argsort(lattice.steps[:, 0])
    found = [-9.0, -6.0, -3.0, 3.0, 6.0, 9.0]
    np.testing.assert_allclose(lattice.steps[order, 0], found, atol=0.1)
    assert np.abs(lattice.steps[:, 1]).max() < 0.1
    assert lattice.share.max() == pytest.approx(0.8)  # 8 of 10 have one to the right
    sharp = np.tile(0.1**2 * np.eye(2), (3, 1, 1))
    step, between, across = lattice.density(np.array([[3.0, 0], [1.5, 0], [0, 3.0]]), sharp)
    assert step > 50 * between
    assert step > 50 * across
    # Known to 3 m, the line of neighbours is a blur.
    blurred = lattice.density(np.array([[3.0, 0], [1.5, 0]]), np.tile(9.0 * np.eye(2), (2, 1, 1)))
    assert blurred[0] == pytest.approx(blurred[1], rel=0.2)
