"""The joint pose graph: scales of odometries that differ, and how stiff a building's grid is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.fusion import joint_graph
from topobatch.merge.fusion.joint_graph import JOINT, bending, settle
from topobatch.merge.fusion.vertex_partition import Pool
from topobatch.topology.map_pose_graph import map_pose_graph
from topobatch.topology.posegraph.samples import SampledMarginals
from topobatch.topology.posegraph.solve import solve
from topobatch.topology.topomap import RunNoise
from topobatch.topology.vertex_errors import VertexErrors


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
    return settle(Pool.of(maps), label, {m.run: np.zeros(3) for m in maps})


def test_each_run_is_given_its_scale(draw):
    maps = [street(draw, "a", 1.02), street(draw, "b", 0.98)]
    joint = settled(maps, (0, 1, 2, 3))
    # Nobody knows which is right: the mean is, by equal priors.
    assert joint.solution.shared == pytest.approx([-0.02, 0.02], abs=0.005)
    # What only one of them saw is stretched by what they saw together.
    assert np.ptp(joint.pose[:9, 0]) == pytest.approx(80.0, abs=0.4)
    assert np.ptp(joint.pose[9:, 0]) == pytest.approx(80.0, abs=0.4)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_what_a_map_bends_is_told_from_how_its_centres_were_seen(draw, times):
    corners = {k: (8.0 * (k % 4) + 3.0 * (k // 4), 6.0 * (k // 4)) for k in range(12)}
    edges = [(k, k + 1) for k in range(11) if k % 4 < 3] + [(k, k + 4) for k in range(8)]
    noise = RunNoise(0.005, 0.0015, 0.0015, scale=0.0, centre_m=0.05)
    plain = replace(draw("a", corners, edges), fitted_noise=noise)
    graph = map_pose_graph(plain)
    error = np.sqrt(times) * SampledMarginals.of(graph, solve(graph), 4096).error
    visits = np.bincount(plain.observation_vertex, minlength=12)[:, None, None]
    seen = np.random.default_rng(0).normal(0, 0.05, (12, 2, 4096)) / np.sqrt(visits)
    whole = np.zeros(12, np.int64)
    bent = VertexErrors(error).as_a_whole(plain.xy, whole).position_sigma()
    # Laying a map of twelve over the truth takes an eighth of how its centres were seen.
    assert np.mean(bent**2) < 0.125 * np.mean(seen**2)
    error[:, :2] += seen
    stated = VertexErrors(error).as_a_whole(plain.xy, whole).position_sigma()
    assert bending(replace(plain, position_sigma=stated)) == pytest.approx(times, rel=0.25)


def test_many_runs_keep_their_scales(draw, monkeypatch):
    maps = [street(draw, "a", 1.02), street(draw, "b", 0.98)]
    monkeypatch.setattr(joint_graph, "JOINT", replace(JOINT, scaled_runs=1))
    joint = settled(maps, (0, 1, 2, 3))
    assert len(joint.solution.shared) == 0
    assert np.ptp(joint.pose[:9, 0]) > np.ptp(joint.pose[9:, 0]) + 1.0
