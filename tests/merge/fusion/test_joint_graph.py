"""The joint pose graph: scales of odometries that differ, and how stiff a building's grid is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.fusion import joint_graph
from topobatch.merge.fusion.joint_graph import JOINT, bending, grid_sigma, settle
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


def test_many_runs_keep_their_scales(draw, monkeypatch):
    maps = [street(draw, "a", 1.02), street(draw, "b", 0.98)]
    monkeypatch.setattr(joint_graph, "JOINT", replace(JOINT, scaled_runs=1))
    joint = settled(maps, (0, 1, 2, 3))
    assert len(joint.solution.shared) == 0
    assert np.ptp(joint.pose[:9, 0]) > np.ptp(joint.pose[9:, 0]) + 1.0


@pytest.mark.parametrize(
    ("crooked", "least", "most"), [(0.0, 0.005, 0.011), (0.03, 0.025, 0.035), (0.15, 0.13, 0.17)]
)
def test_a_grid_is_as_stiff_as_its_junctions_say(crooked, least, most, monkeypatch):
    rng = np.random.default_rng(5)
    run = np.repeat([0, 1], 200)
    spread = np.full(400, 0.02)
    off = rng.normal(0, np.hypot(spread, crooked)) + 0.1 * run
    monkeypatch.setattr(joint_graph, "JOINT", replace(JOINT, min_grid_rad=0.005))
    found = grid_sigma(off, spread, run)
    assert least <= found <= most


def test_few_junctions_leave_a_grid_as_stiff_as_usual():
    run = np.zeros(3, np.int64)
    straight = grid_sigma(np.zeros(3), np.full(3, 0.02), run)
    assert straight == pytest.approx(JOINT.grid_rad, rel=0.1)


def test_corridors_bend_a_map_as_much_as_it_states(draw):
    corners = {k: (6.0 * k, 1.5 * (k % 2)) for k in range(8)}
    plain = draw("a", corners, [(k, k + 1) for k in range(7)])
    assert bending(plain) == 1.0
    sure = {of: bending(replace(plain, position_sigma=np.full(8, of))) for of in (0.01, 2.0, 4.0)}
    assert 0.0 < sure[0.01] < 1.0 < sure[2.0] < sure[4.0]
    assert sure[4.0] == pytest.approx(4 * sure[2.0], rel=0.05)


def test_a_map_without_a_grid_bends_a_tenth_more_than_it_states(draw, monkeypatch):
    square = {k: (10.0 * (k % 3), 8.0 * (k // 3)) for k in range(9)}
    crooked = {
        k: (x + 4.0 * np.sin(5 * k), y + 3.0 * np.cos(3 * k)) for k, (x, y) in square.items()
    }
    edges = [(k, k + 1) for k in range(8) if k % 3 < 2] + [(k, k + 3) for k in range(6)]
    for corners, more in ((square, 1.0), (crooked, 1.1)):
        m = replace(draw("a", corners, edges), position_sigma=np.full(9, 2.0))
        found = bending(m)
        with monkeypatch.context() as patch:
            patch.setattr(joint_graph, "_STIFF", 1.0)
            assert found == pytest.approx(more * bending(m))


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


def test_scales_err_as_far_as_all_runs_of_a_component_tell(draw):
    corners = {k: (8.0 * k, 2.0 * (k % 2)) for k in range(5)}
    edges = [(k, k + 1) for k in range(4)]
    maps = [draw(name, corners, edges) for name in "ab"]
    maps = [
        replace(m, fitted_noise=replace(m.measured, scale=scale))
        for m, scale in zip(maps, (0.04, 0.0), strict=True)
    ]
    label = np.concatenate([np.arange(5), np.arange(5)])
    joint = settle(Pool.of(maps), label, {"a": np.zeros(3), "b": np.zeros(3)})
    np.testing.assert_allclose(joint.graph.shared.sigma, 0.04 / np.sqrt(2))
