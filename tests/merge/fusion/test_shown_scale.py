"""Maps are fused with the lengths that passes show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.merge.fusion.shown_scale import at_shown_scale
from topobatch.merge.merging import merge_maps
from topobatch.simulation import DRIFTS, ScenarioSettings, simulate_scenario, true_vertex_of_nodes
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.se2 import fit_rigid
from topobatch.topology.topomap import LengthScale


@pytest.fixture(scope="module")
def scenario():
    drift = replace(DRIFTS["high"], scale_sigma=0.03)
    return simulate_scenario(
        ScenarioSettings("organic", 2, 0.5, 30, drift=drift, faults="none", seed=12)
    )


@pytest.fixture(scope="module")
def maps(scenario):
    return [build_map(run) for run in scenario.runs.values()]


def test_a_map_is_stretched_about_its_middle(maps) -> None:
    m = replace(maps[0], length_scale=LengthScale(0.02, 0.001))
    out = at_shown_scale(m)
    np.testing.assert_allclose(out.length, 0.98 * m.length)
    away = np.linalg.norm(out.xy - out.xy.mean(axis=0), axis=1)
    np.testing.assert_allclose(away, 0.98 * np.linalg.norm(m.xy - m.xy.mean(axis=0), axis=1))
    # A rigid fit of the one is a rigid fit of the other.
    np.testing.assert_allclose(fit_rigid(out.xy, m.xy), 0.0, atol=1e-9)
    assert out.measured.scale == 0.001
    assert (out.position_sigma <= m.position_sigma).all()
    assert (out.length_sigma <= m.length_sigma).all()
    assert (out.length_sigma > 0).all()
    np.testing.assert_allclose(out.paths[0][0], out.xy[out.source[0]], atol=1e-6)
    nothing = replace(m, length_scale=None)
    assert at_shown_scale(nothing) is nothing


def test_documents_tell_it(maps) -> None:
    scale = maps[0].length_scale
    assert scale is not None
    document = map_to_document(maps[0])
    assert document["graph"]["length_scale"] == {"too_long": scale.too_long, "sigma": scale.sigma}
    assert map_from_document(document).length_scale == scale


@pytest.mark.parametrize(("too_long", "sigma"), [(1.0, 0.1), (float("nan"), 0.1), (0.0, -1.0)])
def test_it_is_a_share_with_a_sigma(too_long: float, sigma: float) -> None:
    with pytest.raises(ValueError, match="share below 1"):
        LengthScale(too_long, sigma)


def test_merged_maps_are_nearer_to_the_truth(scenario, maps) -> None:
    """Lengths of odometries that err by some per cent; maps stay as measured."""
    (world,) = scenario.truth.worlds.values()
    label = {m.run: true_vertex_of_nodes(scenario.truth, m) for m in maps}

    def error(told) -> float:
        """Root mean square of the fused places."""
        fused = merge_maps(told).fused
        of = [
            {int(label[run][v]) for run, vs in members.items() for v in vs}
            for members in fused.members
        ]
        rows = [k for k, seen in enumerate(of) if len(seen) == 1 and min(seen) >= 0]
        there = world.xy[[of[k].pop() for k in rows]]
        T = fit_rigid(there, fused.xy[rows])
        c, s = np.cos(T[2]), np.sin(T[2])
        placed = fused.xy[rows] @ np.array([[c, s], [-s, c]]) + T[:2]
        assert len(rows) > 40
        return float(np.sqrt(np.mean((placed - there) ** 2)))

    assert max(abs(m.length_scale.too_long) for m in maps) > 0.01
    assert error(maps) < 0.85 * error([replace(m, length_scale=None) for m in maps])
