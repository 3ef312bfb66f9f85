"""Estimate by the pose graph: what its factors are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.closure.dead_reckoning import dead_reckoning, relative_covariance
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.manhattan import grid_headings
from topobatch.topology.posegraph.graph import PoseGraph, edge_errors, squared
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


def test_errors_of_legs_lie_along_the_arc_that_a_wrong_turn_leads():
    """Drives whose heading walks end on a banana: χ² of the three numbers of a leg is three, which
    it is not in g2o's metric."""
    loud = replace(NOISE, along_m_per_sqrt_m=0.01, heading_rad_per_sqrt_m=0.03)
    odometry, passes, _ = record(grid_world(1, 3), [(0, 0), (0, 2)])
    reckoning = dead_reckoning(odometry, passes, loud)
    graph = optimise(reckoning, np.arange(2)).graph
    (length,), drives, steps = reckoning.leg, 2000, 100
    rng = np.random.default_rng(5)
    walk = np.cumsum(rng.normal(0, 0.03 * np.sqrt(length / steps), (drives, steps)), axis=1)
    driven = length / steps + rng.normal(0, 0.01 * np.sqrt(length / steps), walk.shape)
    end = (driven * np.exp(1j * walk)).sum(axis=1) * (graph.measurement[0, :2] @ [1, 1j]) / length
    pose = np.zeros((1 + drives, 3))
    pose[1:] = np.column_stack([end.real, end.imag, walk[:, -1]])

    def mean_chi2(information, swing):
        legs = PoseGraph(
            pose,
            np.zeros(drives, np.int64),
            1 + np.arange(drives),
            np.tile(graph.measurement, (drives, 1)),
            np.tile(information, (drives, 1, 1)),
            swing=np.full(drives, swing),
        )
        return squared(edge_errors(legs, pose, np.zeros(0)), legs.information).mean()

    assert mean_chi2(graph.information, graph.swing[0]) == pytest.approx(3.0, abs=0.25)
    in_g2os_metric = np.linalg.inv(relative_covariance(reckoning, np.array([0]), np.array([1])))
    assert mean_chi2(in_g2os_metric, 0.0) > 3.75


def test_layout_of_a_square_spreads_the_error():
    world = grid_world(2, 2)
    odometry, passes, _ = record(world, [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)])
    bent = replace(passes, centre=passes.centre + np.linspace(0, 1, 5)[:, None] * [0.4, 0.0])
    reckoning = dead_reckoning(odometry, bent, NOISE)
    estimate = optimise(reckoning, np.array([0, 1, 2, 3, 0]))
    apart = np.hypot(*(estimate.pose[4, :2] - estimate.pose[0, :2]))
    assert apart < 0.15
    assert len(estimate.xy) == 4
    side = np.hypot(*np.diff(estimate.xy[[0, 1, 2, 3, 0]], axis=0).T)
    assert np.all(np.abs(side - 5.0) < 0.3)
