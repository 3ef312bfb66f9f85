"""What maps state is so: truth within one sigma as often as a sigma promises, on simulated runs."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.truth import true_vertex_of_nodes
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
    runs = [errors_in_sigmas(w, drift, 60 + k) for k in range(6) for w in ("maze", "organic")]
    for name in runs[0]:
        z = np.abs(np.concatenate([run[name] for run in runs]))
        # Some 400 to 800 errors, those of one run not independent: 0.683 to within 0.05 (1 sigma).
        assert 0.57 < np.mean(z < 1.0) < 0.82, name
        assert np.mean(z < 1.96) > 0.88, name
