"""The joint pose graph: scales of odometries that differ, and how stiff a building's grid is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.fusion.joint_graph import optimise_poses
from topobatch.merge.fusion.vertex_partition import Pool
from topobatch.topology.topomap import RunNoise


def street(draw, run, scale):
    """Nine junctions in a row, as an odometry of that scale would have them."""
    corners = {k: (scale * 10.0 * k, 0.0) for k in range(9)}
    lanes = [(k, side) for k in corners for side in (np.pi / 2, -np.pi / 2)]
    drawn = draw(run, corners, [(k, k + 1) for k in range(8)], lanes)
    return replace(drawn, noise=RunNoise(scale=0.02))


def settled(maps, identities):
    """The joint solution if vertex k of each map is one place, for every k of `identities`."""
    label = np.arange(sum(len(m) for m in maps))
    for k in identities:
        label[k :: len(maps[0])] = k
    return optimise_poses(Pool.of(maps), label, {m.run: np.zeros(3) for m in maps})


def test_each_run_is_given_its_scale(draw):
    maps = [street(draw, "a", 1.02), street(draw, "b", 0.98)]
    joint = settled(maps, (0, 1, 2, 3))
    # Nobody knows which is right: the mean is, by equal priors.
    assert joint.solution.shared == pytest.approx([-0.02, 0.02], abs=0.005)
    # What only one of them saw is stretched by what they saw together.
    assert np.ptp(joint.pose[:9, 0]) == pytest.approx(80.0, abs=0.4)
    assert np.ptp(joint.pose[9:, 0]) == pytest.approx(80.0, abs=0.4)
