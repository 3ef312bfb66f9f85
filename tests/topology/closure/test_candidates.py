"""Which pairs of places are asked about, and what likeness is worth."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.closure.candidates import calibrated_odds, candidates
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.matching.likelihood import LIKELIHOOD
from topobatch.topology.se2 import turned_axes

from .walks import NOISE, grid_world, record, scene_of, wander


def test_likeness_is_worth_its_rarity_among_null_pairs():
    null_pairs = np.sort(np.random.default_rng(1).normal(0.0, 3.0, 2000))
    alike = np.linspace(-10.0, 40.0, 101)
    odds = calibrated_odds(alike, null_pairs)
    assert np.all(np.diff(odds) >= 0)
    # Half of the null_pairs look like that: odds of two to one.
    assert calibrated_odds(np.array([np.median(null_pairs)]), null_pairs)[0] == pytest.approx(
        np.log(2), abs=0.01
    )
    top = null_pairs[-1]
    beyond = calibrated_odds(np.array([top + 1e-9, top + 7.0]), null_pairs)
    assert beyond[0] == pytest.approx(np.log(2001), abs=0.01)
    assert beyond[1] - beyond[0] == pytest.approx(7.0)


def test_what_position_excludes_is_no_candidate():
    rng = np.random.default_rng(22)
    world = grid_world(6, 6)
    odometry, passes, _ = record(world, wander(world[1], 120, rng), rng)
    reckoning, each = dead_reckoning(odometry, passes, NOISE), np.arange(len(passes))
    estimate = optimise(reckoning, each)
    state = scene_of(reckoning, estimate)
    found = candidates(state, each, estimate, exact=True)
    a, b = estimate.node[found.a], estimate.node[found.b]
    R = turned_axes(estimate.solution.pose[a, 2])
    cov = (R @ estimate.relative_covariance(a, b) @ R.transpose(0, 2, 1))[:, :2, :2]
    cov += 2 * state.common.centre_sigma**2 * np.eye(2)
    shift = estimate.xy[found.a] - estimate.xy[found.b]
    d2 = np.einsum("ki,kij,kj->k", shift, np.linalg.inv(cov), shift)
    assert len(found) > 20
    assert d2.max() < LIKELIHOOD.gate_chi2(2)
