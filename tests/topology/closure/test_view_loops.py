"""Loops closed by views, on tracks across floors drawn at random."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.view_loops import view_loops
from topobatch.topology.matching.views import ViewIndex
from topobatch.topology.odometry import Odometry
from topobatch.topology.se2 import apply, fit_rigid
from topobatch.topology.topomap import RunNoise

from ..floors import floor, views_at
from ..tracks import passes_at, track

NOISE = RunNoise(along_m_per_sqrt_m=0.03, heading_rad_per_sqrt_m=0.006)
# Twice around a square of 30 m.
ROUND = [(15, 15), (45, 15), (45, 45), (15, 45)] * 2 + [(15, 15), (45, 15)]


def driven(wall, corners, seed, *, bias=0.0015):
    """Dead reckoning of views every 3 m of a drifting track, their index, and where they truly
    were."""
    truth, _ = track(*corners)
    rows = np.arange(0, len(truth), 30)
    rng = np.random.default_rng(seed)
    step = np.diff(truth.pose[:, 0] + 1j * truth.pose[:, 1])
    turn = bias * np.cumsum(np.abs(step)) + 0.002 * np.cumsum(rng.normal(0, 1, len(step)))
    path = np.cumsum(np.concatenate([[0], step * np.exp(1j * turn)]))
    pose = np.column_stack([path.real, path.imag, truth.pose[:, 2] + np.append(0, turn)])
    odometry = Odometry(truth.time_ns, pose, np.zeros(0, np.int64))
    # A view's axes are those of the odometry.
    off = np.append(0, turn)[rows]
    seen = views_at(wall, np.column_stack([truth.pose[rows, :2], -off]))
    nodes = passes_at(truth.time_ns[rows], pose[rows, :2])
    reckoning = dead_reckoning(odometry, nodes, NOISE)
    way = np.cumsum(odometry.step_m)[rows]
    return reckoning, ViewIndex.of(seen), way, truth.pose[rows, :2]


def rmse(xy, truth):
    off = apply(fit_rigid(truth, xy), xy) - truth
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def test_a_track_that_comes_by_again_is_laid_out_again():
    reckoning, index, way, truth = driven(floor(11), ROUND, 1)
    closed, estimate = view_loops(reckoning, index, way)
    before = rmse(reckoning.passes.centre, truth)
    assert before > 1.0
    assert rmse(estimate.pose[:, :2], truth) < 0.15 * before
    loops = closed.loops
    assert len(loops) > 10
    gap = truth[loops.target] - truth[loops.source]
    np.testing.assert_allclose(np.hypot(*gap.T), np.hypot(*loops.measurement[:, :2].T), atol=0.5)


def test_equal_places_make_no_loops():
    # Four aisles with the same walls beside each: each looks like the others.
    wall = np.zeros((600, 600), bool)
    one = floor(13)[:100, :]
    for k in range(6):
        wall[100 * k : 100 * (k + 1)] = one
    line = [(8, 8), (52, 8), (52, 18), (8, 18), (8, 28), (52, 28), (52, 38), (8, 38)]
    reckoning, index, way, truth = driven(wall, line, 3, bias=0.0003)
    closed, _ = view_loops(reckoning, index, way)
    gap = truth[closed.loops.target] - truth[closed.loops.source]
    assert not np.any(np.hypot(*gap.T) > 5.0)
