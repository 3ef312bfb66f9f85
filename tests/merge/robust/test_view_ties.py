"""Registered views as measurements between the junctions of two maps."""

from dataclasses import replace

import numpy as np

from topobatch.merge.fusion.fuse import fuse_component
from topobatch.merge.merging import merge_maps
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.merge.robust import DEFAULT_ROBUST
from topobatch.merge.robust.pairing import Pairwise
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.rematching import MergedMaps
from topobatch.merge.robust.view_evidence import overlaps, repeats, view_evidence
from topobatch.merge.robust.view_search import pictured
from topobatch.merge.robust.view_ties import view_ties
from topobatch.topology.se2 import apply, compose, inverse, wrap
from topobatch.topology.views import NO_VIEWS

from ...maps import straight_map
from .rooms import line, views_of, walls_of

T_B_WORLD = np.array([5.0, -3.0, 2.0])


def seen_by_both():
    """Two maps of one room, and what their views say at the true placement."""
    walls, places = walls_of(1), line((5, 20), (35, 20))
    a = straight_map("a", [(5, 20), (35, 20)], [(0, 1)])
    b = straight_map("b", [(6, 20), (34, 20)], [(0, 1)], T=T_B_WORLD)
    a = replace(a, views=views_of(walls, places))
    b = replace(b, views=views_of(walls, places, T_B_WORLD))
    one, two = pictured(a.views), pictured(b.views)
    overlap = overlaps(one, two, [compose(inverse(T_B_WORLD), b.views.pose)], 24)[0]
    return a, b, view_evidence(overlap, [], (repeats(a.views), repeats(b.views)), np.zeros(0))


def test_views_of_exchanged_maps_are_as_well_registered() -> None:
    *_, views = seen_by_both()
    exchanged, error = views.exchanged(), np.array([1e-6, -2e-6, 3e-6])
    change = inverse(views.transform + error) - exchanged.transform
    weighted = np.einsum("ki,kij,kj->k", change, exchanged.information, change)
    np.testing.assert_allclose(weighted, (views.information @ error) @ error, rtol=1e-4)


def test_ties_say_where_junctions_lie() -> None:
    a, b, views = seen_by_both()
    ties = view_ties(prepare(a), prepare(b), views)
    assert len(ties.source) >= 8
    true = apply(inverse(T_B_WORLD), b.xy[ties.target]) - a.xy[ties.source]
    off = ties.measurement[:, :2] - true
    assert np.hypot(*off.T).max() < 0.5
    assert np.abs(wrap(ties.measurement[:, 2] + T_B_WORLD[2])).max() < 0.03
    np.linalg.cholesky(ties.information)  # positive definite


def test_maps_with_one_wrong_match_are_laid_out_by_their_views() -> None:
    a, b, views = seen_by_both()
    wrong = np.array([[0, 1]])  # the far ends: half a turn off by themselves
    T_a_b = inverse(T_B_WORLD)
    ties = view_ties(prepare(a), prepare(b), views)
    best = Alignment(T_a_b, 20.0, wrong, 0.1, ties=ties)
    pair = PairVerdict("a", "b", Verdict.MERGED, True, 20.0, "", best=best)
    pose = fuse_component([a, b], [pair])[0].poses["b"]
    apart = apply(pose, b.xy) - apply(T_a_b, b.xy)
    assert np.hypot(*apart.T).max() < 1.0


def test_a_merged_map_has_the_views_of_its_runs() -> None:
    a, b, views = seen_by_both()
    ties = view_ties(prepare(a), prepare(b), views)
    best = Alignment(inverse(T_B_WORLD), 20.0, np.array([[0, 0], [1, 1]]), 0.1, ties=ties)
    merged = MergedMaps(Pairwise([a, b], DEFAULT_ROBUST)).of((0, 1), {(0, 1): best}).as_map
    # Both runs saw the same ten places: those of the first serve.
    assert len(merged.views) == len(a.views)
    assert np.abs(merged.views.pose - a.views.pose).max() < 0.8  # their ends differ by 1 m
    apart = replace(a, views=NO_VIEWS)
    of_b = MergedMaps(Pairwise([apart, b], DEFAULT_ROBUST)).of((0, 1), {(0, 1): best}).as_map.views
    assert np.abs(of_b.pose[:, :2] - a.views.pose[:, :2]).max() < 0.8  # their ends differ by 1 m
    assert np.array_equal(of_b.cells, b.views.cells)


def test_maps_without_a_common_junction_are_merged_by_their_views() -> None:
    walls, places = walls_of(1), line((5, 20), (35, 20), 14)
    a = straight_map("a", [(5, 20), (20, 20)], [(0, 1)])
    b = straight_map("b", [(27, 20), (35, 20)], [(0, 1)], T=T_B_WORLD)
    a = replace(a, views=views_of(walls, places))
    b = replace(b, views=views_of(walls, places, T_B_WORLD))
    merged = merge_maps([a, b])
    (verdict,), (component,) = merged.verdicts, merged.components
    assert verdict.verdict is Verdict.MERGED
    assert verdict.best is not None
    assert len(verdict.best.matched) == 0
    off = compose(component.poses["b"], T_B_WORLD)
    assert np.hypot(*off[:2]) < 0.8
    assert abs(wrap(off[2])) < 0.05
    elsewhere = replace(b, views=views_of(walls_of(2), places, T_B_WORLD))
    assert len(merge_maps([a, elsewhere]).components) == 2
