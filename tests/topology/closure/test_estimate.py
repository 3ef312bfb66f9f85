"""Estimate by the pose graph: what its factors are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.manhattan import grid_headings
from topobatch.topology.se2 import wrap

from .walks import NOISE, grid_world, record, wander


def test_layout_begins_with_the_headings_of_the_grid():
    """Odometry that has turned round by itself twice is laid straight at once."""
    rng = np.random.default_rng(23)
    world = grid_world(8, 8, rng)
    loud = replace(NOISE, heading_rad_per_sqrt_m=0.03)
    odometry, passes, truth = record(world, wander(world[1], 700, rng), rng, noise=loud, bias=0.004)
    reckoning = dead_reckoning(odometry, passes, loud)
    estimate = optimise(reckoning, np.arange(len(reckoning)), grid=grid_headings(reckoning))
    assert estimate.solution.converged
    assert estimate.solution.iterations < 10
    true = np.array([world[0][v] for v in truth])
    step, there = np.diff(estimate.pose[:, :2], axis=0), np.diff(true, axis=0)
    turn = np.arctan2(*step.T[::-1]) - np.arctan2(*there.T[::-1])
    assert np.quantile(np.abs(wrap(turn - np.median(turn))), 0.99) < 0.2
