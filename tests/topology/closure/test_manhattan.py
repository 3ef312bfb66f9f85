"""Headings and corridors along the grid of a building."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.manhattan import grid_corridors, grid_headings
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import wrap

from .walks import NOISE, aisles, grid_world, record, wander


def test_grid_headings_follow_the_drift():
    rng = np.random.default_rng(13)
    world = grid_world(5, 5, rng)
    odometry, passes, junctions = record(world, wander(world[1], 60, rng), rng)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    grid = grid_headings(reckoning)
    assert grid is not None
    seen = [passes.branches[i] for i in range(len(passes))]
    aligned = [wrap(4 * (seen[i] + t)) / 4 for i, t in zip(grid.row, grid.turn, strict=True)]
    spread = np.concatenate([a - aligned[0].mean() for a in aligned])
    assert np.abs(np.asarray(wrap(4 * spread)) / 4).max() < 0.2
    # Streets at any angle are no grid.
    fork = np.array([-2.0, 0.1, 2.2])
    bent = replace(
        passes,
        branches=Ragged.from_rows([fork] * len(passes)),
        entry=np.zeros(len(passes), int),
        exit=np.ones(len(passes), int),
    )
    assert grid_headings(replace(reckoning, passes=bent)) is None
    # Nor are streets that cross at right angles, each crossing turned by itself.
    own = {v: rng.uniform(-0.4, 0.4) for v in world[0]}
    turned = np.array([own[v] for v in junctions])[passes.branches.owner]
    branches = Ragged(passes.branches.offsets, passes.branches.values + turned)
    assert grid_headings(replace(reckoning, passes=replace(passes, branches=branches))) is None


def test_corridors_of_a_grid_go_straight_or_round_one_corner():
    route = [(0, 0), (0, 1), (0, 2), (1, 2), (1, 3), (0, 3), (0, 4), (0, 3)]
    odometry, passes, _ = record(aisles(5, 30.0), route, unseen=(3,))
    reckoning = dead_reckoning(odometry, passes, NOISE)
    grid = grid_headings(reckoning)
    turn = np.zeros(len(reckoning))
    found = grid_corridors(reckoning, grid, turn, 3.0)
    # Back the same way is another corridor; nobody saw where the third one bent.
    assert found.corridor.tolist() == [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert found.row.tolist() == [0, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6]
    np.testing.assert_allclose(found.aside, [0, 0, 0, 0, -3, 0, 0, 0, 0, 0, 0], atol=1e-6)
    ahead = np.array([0, 1, -1, 0, 2]) * np.pi / 2
    np.testing.assert_allclose(wrap(found.direction - ahead), 0.0, atol=1e-6)
    # Who might have come out on a corridor beside it says nothing.
    assert (
        len(grid_corridors(replace(reckoning, leg=reckoning.leg + 3.0), grid, turn, 3.0).row) == 0
    )
