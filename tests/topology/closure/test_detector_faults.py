"""How often a detector is at fault, from tables of places drawn by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.detector_faults import RateSettings, measured_rates
from topobatch.topology.closure.places import tabulate

from .walks import NOISE, grid_world, partition, record


def test_without_faults_the_rate_of_missed_junctions_falls_below_its_prior():
    route = [(0, 0), (0, 1), (0, 0), (0, 1), (1, 1)]
    odometry, passes, truth = record(grid_world(2, 2), route)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    rates = measured_rates(
        tabulate(reckoning, partition(truth), np.zeros(len(passes)), 0.35), NOISE
    )
    assert rates.miss_rate < NOISE.miss_rate
    # No place was visited three times: nothing tells of its branches.
    assert rates.branch_fault_rate == pytest.approx(NOISE.branch_fault_rate)


def test_rates_are_counts_of_faults_beside_the_prior():
    # Of four drives along one corridor one came out elsewhere; of the four visits to the place one
    # did not see its second branch.
    places = SimpleNamespace(
        tried=np.array([[4, 1]]),
        driven=np.array([[3, 1]]),
        visits=np.array([4]),
        share=np.array([[1.0, 0.75]]),
        heading=np.array([[0.0, np.pi / 2]]),
    )
    rates = measured_rates(places, NOISE, RateSettings(prior_passes=10.0))
    assert rates.miss_rate == pytest.approx((10 * NOISE.miss_rate + 1) / 13)
    assert rates.branch_fault_rate == pytest.approx((10 * NOISE.branch_fault_rate + 1) / 14)
