"""The index of corridors: which pairs of maps have a chance."""

import numpy as np
import pytest

from topobatch.merge.document import merged_to_document
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.merging import merge_maps
from topobatch.merge.result import pairs_of
from topobatch.merge.robust import prepare
from topobatch.merge.robust.index import Corridors
from topobatch.merge.robust.links import _components, candidate_links
from topobatch.merge.robust.screening import ScreeningSettings, likely_pairs
from topobatch.simulation import make_world


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


def by_one(a, b):
    """What `Corridors.chances` says, pair by pair through the links of matching."""
    links = candidate_links(a, b)
    if len(links) == 0:
        return -np.inf
    total = np.bincount(_components(a, b, links), links.bits)
    return total.max() - np.log2(len(links) + 1.0)


def test_it_is_the_first_step_of_matching_for_all_maps_at_once(buildings):
    ready = [prepare(m) for m in buildings]
    index = Corridors.of(ready)
    for i, a in enumerate(ready):
        found = index.chances([a], -np.inf)[0]
        slow = np.array([by_one(a, b) for b in ready])
        known = np.isfinite(slow)
        np.testing.assert_array_equal(np.isfinite(found), known)
        np.testing.assert_allclose(found[known], slow[known], atol=1e-6)
        late = index.chances([a], 12.0, np.array([i]))[0]
        assert (late[: i + 1] == -np.inf).all()
        np.testing.assert_array_equal(late[i + 1 :], index.chances([a], 12.0)[0, i + 1 :])


def test_maps_without_corridors_have_no_chance(buildings, see, maze):
    lone = prepare(see(maze, [0], 1, "lone"))
    ready = [lone, prepare(buildings[0]), lone]
    assert likely_pairs(ready, 6.0).shape == (0, 2)
    assert likely_pairs([], 6.0).shape == (0, 2)


@pytest.fixture
def large(monkeypatch):
    """Fifteen runs are a large merge."""
    monkeypatch.setattr(
        "topobatch.merge.robust.screening.SCREENING", ScreeningSettings(most_pairs=50)
    )
    monkeypatch.setattr("topobatch.merge.merging.MOST_LISTED", 50)


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


def test_pairs_with_nothing_to_say_are_counted(buildings, large):
    result = merge_maps(buildings)
    rest = result.unlisted
    assert rest.screened > 0
    assert sum(result.standings().values()) == pairs_of(len(buildings))
    assert len(result.verdicts) + rest.joined + rest.unrelated + rest.screened == pairs_of(15)
    home = {run: c.id for c in result.components for run in c.poses}
    together = sum(home[a] == home[b] for a in home for b in home if a < b)
    listed = sum(home[v.a] == home[v.b] for v in result.verdicts)
    assert rest.joined == together - listed
    document = MergedDocument.model_validate(merged_to_document(result))
    assert document.graph.unlisted.screened == rest.screened
    assert len(document.merges) == len(result.verdicts)


def test_the_threshold_is_that_of_all_pairs(buildings, request):
    def thresholds():
        """Of pairs judged alone: components that are matched together have one of their own."""
        return {v.threshold_bits for v in merge_maps(buildings).verdicts if not v.together}

    before = thresholds()
    assert len(before) == 1
    request.getfixturevalue("large")
    assert thresholds() == before
