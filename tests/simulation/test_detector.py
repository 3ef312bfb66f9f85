"""Junction detections, and what is wrong with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.simulation.scenario import simulate_run
from topobatch.simulation.settings import Faults
from topobatch.simulation.truth import true_vertex_of_passes
from topobatch.simulation.worlds import make_world
from topobatch.topology.se2 import apply, compose, wrap

from .driven import KINDS, PERFECT, truth_of


def _unmatched(seen: np.ndarray, want: np.ndarray) -> float:
    """Largest angle from a heading seen to the nearest one wanted; infinite if counts differ."""
    if len(seen) != len(want):
        return np.inf
    return float(np.max(np.min(np.abs(wrap(seen[:, None] - want[None, :])), axis=1)))


@pytest.mark.parametrize("kind", KINDS)
def test_without_noise_everything_is_where_the_world_says(kind: str) -> None:
    world = make_world(kind, 40, seed=6)
    simulated = simulate_run(world, settings=PERFECT, seed=6)
    run, truth = simulated.run, truth_of(simulated, world)
    T_world_base = compose(simulated.truth.T_world_odom, run.odometry.at(run.detections.time_ns))
    centre = apply(T_world_base, run.detections.centre)
    vertex = true_vertex_of_passes(truth, "run", run.detections.time_ns)
    assert np.max(np.hypot(*(centre - world.xy[vertex]).T)) < 0.02
    for row in range(0, len(run.detections), 7):
        turned = run.detections.branches[row] + T_world_base[row, 2]
        assert _unmatched(turned, world.branches[int(vertex[row])]) < 0.02


def test_closed_doors_are_neither_seen_nor_driven() -> None:
    world = make_world("office", 80, 2)
    shut = simulate_run(
        world, settings=replace(PERFECT, faults=Faults(0.0, 0.0, 0.0, closed_share=0.2)), seed=5
    )
    truth = shut.truth
    assert len(truth.closed_edges) > 3
    assert not set(truth.closed_edges) & set(truth.drive_edge.tolist())
    counts = shut.run.detections.branches.counts
    vertex = true_vertex_of_passes(truth_of(shut, world), "run", shut.run.detections.time_ns)
    missing = np.bincount(
        np.concatenate([world.source, world.target])[
            np.tile(np.isin(np.arange(len(world.source)), truth.closed_edges), 2)
        ],
        minlength=len(world),
    )
    np.testing.assert_array_equal(counts, (world.branches.counts - missing)[vertex])


def test_faults_come_at_their_rates() -> None:
    faults = Faults(
        missed_pass_rate=0.2, wrong_pass_rate=0.1, phantom_rate=0.2, wrong_message_rate=0.1
    )
    world = make_world("maze", 150, 4)
    simulated = simulate_run(world, settings=replace(PERFECT, faults=faults), seed=2)
    truth = simulated.truth
    visits = np.count_nonzero(truth.vertex >= 0)
    assert truth.fault.count("missed") / visits == pytest.approx(0.2, abs=0.06)
    assert truth.fault.count("wrong pass") / visits == pytest.approx(0.08, abs=0.05)
    assert truth.fault.count("phantom") > 10
    assert all(
        (m == 0) == (f == "missed") for m, f in zip(truth.messages, truth.fault, strict=True)
    )
    vertex = true_vertex_of_passes(truth_of(simulated, world), "run", truth.start_ns)
    right = [f == "" for f in truth.fault]
    np.testing.assert_array_equal(vertex[right], truth.vertex[right])
