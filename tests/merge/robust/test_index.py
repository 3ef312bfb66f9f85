"""The index of corridors: which pairs of maps have a chance."""

import numpy as np
import pytest

from topobatch.merge.merging import merge_maps
from topobatch.merge.result import pairs_of
from topobatch.merge.robust.screening import similar_pairs
from topobatch.simulation.worlds import make_world
from topobatch.topology.views import NO_VIEWS

from .rooms import line, views_of, walls_of


@pytest.fixture(scope="module")
def buildings(see):
    """Fifteen maps of five buildings of all kinds."""
    maps = []
    for k, kind in enumerate(("maze", "organic", "office", "city", "maze")):
        world = make_world(kind, 60, 30 + k)
        across = np.argsort(np.argsort(world.xy[:, 0])) / len(world.xy)
        for n, (low, high) in enumerate([(0.0, 0.6), (0.3, 0.9), (0.5, 1.0)]):
            rows = np.flatnonzero((across >= low) & (across <= high)).tolist()
            maps.append(see(world, rows, 10 * k + n, f"b{k}-{n}"))
    return maps


@pytest.fixture
def large(monkeypatch):
    """Fifteen runs are a large merge."""
    monkeypatch.setattr("topobatch.merge.robust.screening.MOST_PAIRS", 50)
    monkeypatch.setattr("topobatch.merge.merging.MOST_PAIRS", 50)


def test_screening_loses_nothing(buildings, request):
    whole = merge_maps(buildings)
    request.getfixturevalue("large")
    screened = merge_maps(buildings)
    assert whole.unlisted is None
    accepted = [
        {(v.a, v.b): v.evidence_bits for v in r.verdicts if v.accepted} for r in (whole, screened)
    ]
    assert len(accepted[0]) >= 8
    # Pairs beyond chance are counted with caution, so that a bit or less is missing.
    assert accepted[1].keys() == accepted[0].keys()
    assert accepted[1] == pytest.approx(accepted[0], abs=0.3)
    homes = [sorted(sorted(c.poses) for c in r.components) for r in (whole, screened)]
    assert homes[0] == homes[1]


def test_maps_are_matched_with_those_whose_views_look_most_alike(monkeypatch):
    monkeypatch.setattr("topobatch.merge.robust.screening.PARTNERS", 2)
    places, again = line((5, 20), (35, 20), 20), line((35, 20.5), (5, 20.5), 20)
    walls = [walls_of(seed) for seed in range(6)]
    turned = [views_of(w, again, (5.0, -3.0, 2.0)) for w in walls]
    views = [NO_VIEWS, *(views_of(w, places) for w in walls), NO_VIEWS, *turned]
    chosen = {tuple(pair) for pair in similar_pairs(views).tolist()}
    assert {(1 + k, 8 + k) for k in range(6)} <= chosen
    assert len(chosen) < 30 < pairs_of(12)
    assert all(len(views[k]) for pair in chosen for k in pair)
    assert len(similar_pairs(views[:4])) == 3
