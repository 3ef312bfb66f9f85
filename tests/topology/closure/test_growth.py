"""What corridors around two places tell of their being one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.topology.closure.branches import align, branches_of
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.evidence import EvidenceSettings, background
from topobatch.topology.closure.growth import GrowthSettings, MapState, grow
from topobatch.topology.closure.places import tabulate

from .walks import NOISE, grid_world, partition, record, wander


def test_blocks_between_the_same_two_streets_count_once():
    """One street off, the blocks along it are as long: that makes no place of two."""
    rng = np.random.default_rng(33)
    world = grid_world(6, 6, rng)
    odometry, passes, truth = record(world, wander(world[1], 150, rng), rng)
    reckoning, place = dead_reckoning(odometry, passes, NOISE), partition(truth)
    estimate = optimise(reckoning, place)
    places = tabulate(reckoning, place, estimate.pose[:, 2])
    common = background(reckoning, reckoning.noise)
    state = MapState(
        reckoning, places, estimate.xy, common, branches_of(places, common, EvidenceSettings())
    )
    number = {v: int(place[k]) for k, v in enumerate(truth)}
    off = [(number[v], number[v[0] + 1, v[1]]) for v in number if (v[0] + 1, v[1]) in number]
    a, b = np.array(off).T
    turned = align(state.branches, a, b, turn_sigma=np.full(len(a), 0.05))
    lengths = GrowthSettings(branch_cap=0.0)
    independent = grow(state, a, b, turned, replace(lengths, line_m=0.0))
    together = grow(state, a, b, turned, lengths)
    assert (together.gain <= independent.gain + 1e-9).all()
    assert together.gain.mean() < 0.6 * independent.gain.mean()
