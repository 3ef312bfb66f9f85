"""Centres of crossings: where axes of corridors meet, or the fork where branches are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from topobatch.ingest.scans.crossing import (
    AXIS_M,
    FORK_SHARE,
    BendTally,
    Crossing,
    aside,
    bends,
    crossing,
    crossings,
    placed,
)
from topobatch.ingest.scans.skeleton import Node, SkeletonGraph, SkeletonSettings, thin, traced
from topobatch.ingest.scans.skeleton_lines import lines_of
from topobatch.topology.se2 import wrap

CELL = 0.1
SIDE = 120
MIDDLE = np.array([6.0, 6.0])


def corridors(*headings_deg: float, wave_m: float = 0.0) -> np.ndarray:
    """Free cells of corridors, 1.4 m wide, that leave the middle of a square, winding every 3 m."""
    y, x = np.mgrid[:SIDE, :SIDE] * CELL - MIDDLE[0]
    free = np.zeros((SIDE, SIDE), bool)
    for heading in np.radians(headings_deg):
        c, s = np.cos(heading), np.sin(heading)
        along, across = c * x + s * y, c * y - s * x
        free |= (np.abs(across - wave_m * np.sin(2.1 * along)) < 0.701) & (along >= 0)
    return free


def fork_of(free: np.ndarray) -> tuple[SkeletonGraph, Node, np.ndarray]:
    """The skeleton of a grid with one junction, its node, and the distance from walls."""
    clearance = ndimage.distance_transform_edt(np.pad(free, 1, mode="edge"))[1:-1, 1:-1] * CELL
    settings = SkeletonSettings()
    graph = traced(lines_of(thin(clearance > settings.clearance_m), clearance, CELL), settings)
    (node,) = graph.nodes
    return graph, node, clearance


def seen(free: np.ndarray, tally: BendTally | None = None) -> tuple[Node, Crossing]:
    """The one junction of a grid, as the skeleton forks and as its corridors cross."""
    graph, node, clearance = fork_of(free)
    place = placed(graph, node, clearance, CELL, tally=tally)
    return node, crossing(graph, place, CELL, SkeletonSettings())


def of_a_run(axes: int, bent: int) -> BendTally:
    """So many axes, each of which surely bends or surely does not."""
    tally = BendTally()
    tally.add([20.0] * bent + [-20.0] * (axes - bent))
    return tally


@pytest.mark.parametrize("sharp", [40, 50, 60, 75])
def test_acute_crossings_are_where_their_axes_meet(sharp: float) -> None:
    node, found = seen(corridors(0, 180, sharp))
    off = np.hypot(*(found.xy - MIDDLE))
    assert off < max(0.15, 0.5 * np.hypot(*(node.xy - MIDDLE)))
    assert off < 0.25
    apart = np.abs(wrap(found.headings[:, None] - np.radians([0, 180, sharp])))
    assert apart.min(axis=0).max() < 0.15


def test_corridors_that_bend_cross_where_their_bends_lead() -> None:
    y, x = np.mgrid[:SIDE, :SIDE] * CELL - MIDDLE[0]
    free = (np.abs(y - 0.05 * x * x) <= 0.7) | ((np.abs(x + 0.04 * y * y) <= 0.7) & (y >= 0))
    node, found = seen(free, of_a_run(200, bent=180))
    off = np.hypot(*(found.xy - MIDDLE))
    assert off < 0.5 * np.hypot(*(node.xy - MIDDLE))
    assert off < 3 * found.sigma_m


def test_axes_tell_a_centre_better_than_the_fork() -> None:
    _, straight = seen(corridors(0, 180, 90))
    _, winding = seen(corridors(0, 180, 90, wave_m=0.4))
    fork = np.sqrt(0.5 * np.trace(aside(np.radians([0, 90, 180])))) * winding.clearance_m
    assert winding.sigma_m == pytest.approx(fork, rel=0.1)
    assert straight.sigma_m < 0.5 * winding.sigma_m


def test_winding_ways_have_no_axes() -> None:
    node, found = seen(corridors(0, 180, 90, wave_m=0.4))
    assert np.array_equal(found.xy, node.xy)
    assert len(found.headings) == 3


def bent(free: np.ndarray, *, off_m: float = 0.0) -> np.ndarray:
    """How branches of the one junction of a grid turn, with its centre moved along y."""
    graph, node, clearance = fork_of(free)
    settings = SkeletonSettings()
    moved = replace(placed(graph, node, clearance, CELL), xy=MIDDLE + np.array([0.0, off_m]))
    return bends(graph, crossing(graph, moved, CELL, settings), CELL, settings)


def test_branches_turn_by_half_of_what_a_centre_is_off() -> None:
    rounding = CELL / 1.5 + CELL / 3.0
    assert np.abs(bent(corridors(0, 180, 90))).max() <= rounding
    west, east, north = bent(corridors(0, 180, 90), off_m=0.6)[[0, 1, 2]]
    half = np.arctan2(0.6, 1.5) - np.arctan2(0.6, 3.0)
    assert sorted([west, east]) == pytest.approx([-half, half], abs=rounding)
    assert north == pytest.approx(0.0, abs=rounding)


def test_branches_that_end_before_tell_no_bend() -> None:
    free = corridors(0, 180, 90)
    x = np.arange(SIDE) * CELL - MIDDLE[0]
    free[:, x > 2.5] = False
    assert np.isnan(bent(free)).sum() == 1


def test_forks_lie_aside_of_the_corridor_that_a_branch_leaves() -> None:
    least = FORK_SHARE**2
    right = aside(np.radians([0, 90, 180]))
    np.testing.assert_allclose(right, np.diag([least, least + 0.2**2]), atol=1e-12)
    acute = aside(np.radians([0, 45, 180]))
    expected = np.diag([least + 1 / 1.5**2, least + 1.25 / 1.5**2])
    np.testing.assert_allclose(acute, expected, atol=1e-12)
    turned = aside(np.radians([90, 180, 270]))
    np.testing.assert_allclose(turned, right[::-1, ::-1], atol=1e-12)
    sharpest = aside(np.radians([0.0, 30.0, 180]))
    np.testing.assert_allclose(aside(np.radians([0.0, 10.0, 180])), sharpest)


def test_how_a_fork_lies_aside_hangs_on_no_order_of_bearings() -> None:
    """A branch along the grid points to -90 or to 270 degrees, as rounding has it."""
    one = aside(np.radians([-90.0, 152.4, 72.8]))
    np.testing.assert_allclose(aside(np.radians([270.0, 152.4, 72.8])), one, atol=1e-12)
    np.testing.assert_allclose(aside(np.radians([72.8, -90.0, 152.4])), one, atol=1e-12)


def test_corridors_cross_where_the_fork_is() -> None:
    np.testing.assert_allclose(aside(np.radians([0, 80, 180, 260])), FORK_SHARE**2 * np.eye(2))


def test_a_fork_gives_way_where_axes_agree() -> None:
    graph, node, clearance = fork_of(corridors(0, 180, 90))
    far = replace(node, xy=node.xy + np.array([0.6, 0.0]))
    found = placed(graph, far, clearance, CELL)
    assert np.hypot(*(found.xy - MIDDLE)) < 0.1


def test_what_bent_before_bends() -> None:
    """Axes of a run in which none bent are surer than those of which nothing is known."""
    graph, node, clearance = fork_of(corridors(0, 180, 90))
    tallies = [of_a_run(200, bent) for bent in (0, 100, 200)]
    assert [t.usual for t in tallies] == pytest.approx([0.0, 0.5, 1.0], abs=0.03)
    sigma = [placed(graph, node, clearance, CELL, tally=t).sigma_m for t in tallies]
    assert sigma[0] < sigma[1] < sigma[2]


def test_axes_too_short_to_tell_leave_open_how_many_bend() -> None:
    tally = of_a_run(20, bent=2)
    before = tally.usual
    tally.add([0.0] * 1000)
    assert tally.usual == pytest.approx(before, abs=1e-12)
    assert BendTally().usual == pytest.approx(0.5)


def test_cells_as_large_as_an_axis_have_none() -> None:
    free = np.zeros((40, 40), bool)
    free[18:22] = free[:, 18:22] = True
    cell_m = AXIS_M
    clearance = ndimage.distance_transform_edt(np.pad(free, 1, mode="edge"))[1:-1, 1:-1] * cell_m
    settings = SkeletonSettings()
    graph = traced(lines_of(thin(clearance > settings.clearance_m), clearance, cell_m), settings)
    for node in graph.nodes:
        found = crossing(graph, placed(graph, node, clearance, cell_m), cell_m, settings)
        assert np.array_equal(found.xy, node.xy)
        assert np.isfinite(found.headings).all()
    assert graph.nodes


def places(free: np.ndarray) -> tuple[int, list[Crossing]]:
    """Nodes of the skeleton of a grid, and what places they are."""
    clearance = ndimage.distance_transform_edt(np.pad(free, 1, mode="edge"))[1:-1, 1:-1] * CELL
    settings = SkeletonSettings()
    graph = traced(lines_of(thin(clearance > settings.clearance_m), clearance, CELL), settings)
    numbers = range(len(graph.nodes))
    found = crossings(graph, numbers, clearance, CELL, settings).places.values()
    return len(numbers), [crossing(graph, node, CELL, settings) for node in found]


@pytest.mark.parametrize("sharp", [44, 47, 50])
def test_two_forks_whose_axes_cross_at_one_place_are_one(sharp: float) -> None:
    forks, found = places(corridors(0, 180, sharp, sharp + 180))
    assert forks == 2
    (one,) = found
    assert np.hypot(*(one.xy - MIDDLE)) < 0.25
    wanted = np.radians([0, 180, sharp, sharp + 180])
    assert len(one.headings) == 4
    assert np.abs(wrap(one.headings[:, None] - wanted)).min(axis=0).max() < 0.2


def test_corridors_that_leave_farther_apart_are_two_places() -> None:
    side = np.roll(corridors(-90), 16, axis=1)
    forks, found = places(corridors(0, 180, 90) | side)
    assert forks == len(found) == 2
    assert all(len(place.headings) == 3 for place in found)
