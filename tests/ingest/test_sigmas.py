"""What maps state is so: truth within one sigma as often as a sigma promises, on simulated runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation import (
    DRIFTS,
    ScenarioSettings,
    simulate_scenario,
    true_vertex_of_nodes,
)
from topobatch.topology.se2 import apply, fit_rigid, wrap
from topobatch.topology.topomap import TopoMap


def errors_in_sigmas(world: str, drift: str, seed: int) -> dict[str, np.ndarray]:
    """Errors of one map's lengths, vertices (both coordinates) and branches."""
    scenario = simulate_scenario(
        ScenarioSettings(world, 1, junctions_per_run=25, drift=drift, faults="none", seed=seed)
    )
    (run,) = scenario.runs.values()
    topomap = build_map(run)
    label = true_vertex_of_nodes(scenario.truth, topomap)
    (true,) = scenario.truth.worlds.values()
    known = np.flatnonzero(label >= 0)
    T_map_world = fit_rigid(topomap.xy[known], true.xy[label[known]])
    off = topomap.xy[known] - apply(T_map_world, true.xy[label[known]])
    turns = []
    for n in known.tolist():
        turn = wrap(topomap.branches[n][:, None] - true.branches[int(label[n])] - T_map_world[2])
        turns.append(np.abs(turn).min(axis=1) / topomap.branch_sigma[n])
    return {
        "length": lengths_in_sigmas(topomap, true, label),
        "place": (off / topomap.position_sigma[known, None]).ravel(),
        "branch": np.concatenate(turns),
    }


def lengths_in_sigmas(topomap: TopoMap, true, label: np.ndarray) -> np.ndarray:
    """Errors of the corridors that are the only ones between their junctions."""
    pairs = [tuple(sorted(p)) for p in zip(true.source.tolist(), true.target.tolist(), strict=True)]
    alone = {pair: e for e, pair in enumerate(pairs) if pairs.count(pair) == 1}
    ends = np.sort(label[np.stack([topomap.source, topomap.target], axis=1)], axis=1).tolist()
    found = [(e, alone[tuple(pair)]) for e, pair in enumerate(ends) if tuple(pair) in alone]
    mine, goal = np.array(found).T
    return (topomap.length[mine] - true.length[goal]) / topomap.length_sigma[mine]


@pytest.mark.parametrize("drift", ["none", "mid"])
def test_the_truth_lies_within_one_sigma_as_often_as_it_should(drift: str) -> None:
    runs = [errors_in_sigmas(w, drift, 60 + k) for k in range(4) for w in ("maze", "organic")]
    for name in runs[0]:
        z = np.abs(np.concatenate([run[name] for run in runs]))
        # Some 200 to 500 errors, those of one run not independent: 0.683 to within 0.05 (1 sigma).
        assert 0.57 < np.mean(z < 1.0) < 0.82, name
        assert np.mean(z < 1.96) > 0.88, name


def test_an_odometry_whose_lengths_are_wrong_is_corrected() -> None:
    for scale_sigma in (0.0, 0.05):
        drift = replace(DRIFTS["low"], scale_sigma=scale_sigma)
        scenario = simulate_scenario(
            ScenarioSettings("organic", 1, junctions_per_run=25, drift=drift, faults="none", seed=3)
        )
        (run,), (true,) = scenario.runs.values(), scenario.truth.runs.values()
        ways = [
            np.hypot(*np.diff(p[:, :2], axis=0).T).sum() for p in (run.odometry.pose, true.path)
        ]
        too_long = 1 - ways[1] / ways[0]
        assert abs(too_long) > 0.02 or not scale_sigma
        topomap = build_map(run)
        left = too_long - topomap.info["calibration"]["length_scale"]["applied"]
        assert abs(left) < 3 * topomap.measured.scale < 0.04
        # As headings are good, half of what passes show is taken for the detector's error.
        assert abs(left) < max(0.75 * abs(too_long), 0.005)
        place = true_vertex_of_nodes(scenario.truth, topomap)
        there = scenario.truth.worlds[true.world].xy[place]
        size, truth = (np.hypot(*(xy - xy.mean(axis=0)).T).mean() for xy in (topomap.xy, there))
        assert abs(size / truth - 1) < 3 * topomap.measured.scale
