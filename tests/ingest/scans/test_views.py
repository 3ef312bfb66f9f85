"""Views along a track, loops by them, and views cut from saved grids."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.scan import ScanResult
from topobatch.ingest.scans.views import EVERY_M, grid_views
from topobatch.topology.matching.views import TURN_RAD, ViewIndex, register
from topobatch.topology.run import Grid
from topobatch.topology.se2 import apply, between, compose, fit_rigid

from .building import CELL_M, RING, biased, drive, parts, scans

TWICE = drive(*([(0, 0), (20, 0), (20, 20), (0, 20)] * 2), (0, 0), (10, 0))


@cache
def found() -> ScanResult:
    odometry = biased(TWICE, np.radians(1.0))
    return detect(odometry, parts(scans(RING, TWICE), 64))


def test_every_pass_and_every_few_metres_have_a_view() -> None:
    views, passes = found().scanned.views, found().scanned.passes
    assert (np.diff(views.time_ns) >= 0).all()
    truth = TWICE.at(views.time_ns)
    step = np.hypot(*np.diff(truth[:, :2], axis=0).T)
    assert step.max() < 2 * EVERY_M
    where = apply(TWICE.at(passes.time_ns), passes.centre)
    nearest = np.hypot(*(where[:, None] - truth[:, :2]).transpose(2, 0, 1)).min(axis=1)
    assert nearest.max() < 1.5


def test_a_track_that_comes_by_again_lies_where_it_was_driven() -> None:
    result = found()
    truth = TWICE.at(result.odometry.time_ns)[:, :2]
    ours = result.odometry.pose[:, :2]
    off = apply(fit_rigid(truth, ours), ours) - truth
    assert np.hypot(*off.T).max() < 0.35
    assert len(result.scanned.loops) > 10
    # Views are posed with the odometry.
    at = result.odometry.at(result.scanned.views.time_ns)
    gap = result.scanned.views.pose[:, :2] - at[:, :2]
    assert np.hypot(*gap.T).max() < 0.5


def saved(resolution_m: float, origin: tuple[float, float, float]) -> Grid:
    """The building as a map of another resolution would show it."""
    every = round(resolution_m / CELL_M)
    height, width = (n // every * every for n in RING.free.shape)
    cells = RING.free[:height, :width].reshape(height // every, every, width // every, every)
    free = cells.all(axis=(1, 3))
    seen = cells.any(axis=(1, 3))
    near = np.pad(seen, 2)
    near = np.any([np.roll(near, (y, x), (0, 1)) for y in (-2, 0, 2) for x in (-2, 0, 2)], axis=0)
    return Grid(free, ~near[2:-2, 2:-2] & ~free, resolution_m, origin)


def test_specks_of_a_saved_map_are_no_walls_of_its_views() -> None:
    grid = saved(0.06, (0.0, 0.0, 0.0))
    rows, columns = np.nonzero(grid.free)
    some = np.random.default_rng(0).random(len(rows)) < 0.005
    free = grid.free.copy()
    free[rows[some], columns[some]] = False
    along = np.array([[12.0, 2.0], [22.0, 2.0]])
    clean, speckled = (grid_views(g, along).cells[:2] for g in (grid, grid._replace(free=free)))
    assert some.sum() > 100
    assert (speckled != clean).mean() < 0.001


@pytest.mark.parametrize("resolution_m", [0.06, 0.3])
def test_views_of_a_saved_map_match_those_of_a_laser(resolution_m: float) -> None:
    corner = compose(np.array([3.0, -2.0, 0.4]), np.append(RING.corner, 0.0))
    grid = saved(resolution_m, tuple(corner.tolist()))
    cut = grid_views(grid, np.zeros((0, 2)))
    assert len(cut) > 10
    views = found().scanned.views
    truth = compose(np.array([3.0, -2.0, 0.4]), TWICE.at(views.time_ns))
    # The frame of a laser's view, in that of the saved map.
    track = found().odometry.at(views.time_ns)
    turn = views.pose[:, 2] - track[:, 2]
    place = apply(truth, apply(between(track, np.zeros(3)), views.pose[:, :2]))
    pose = np.column_stack([place, truth[:, 2] + turn])
    first, second = np.nonzero(
        np.hypot(*(cut.pose[:, None, :2] - pose[None, :, :2]).transpose(2, 0, 1)) < 1.5
    )
    assert len(first) > 5
    expected = between(cut.pose[first], pose[second])
    turns = expected[:, 2:] + np.arange(-2, 3) * TURN_RAD
    same = register(
        *(ViewIndex.of(cut), ViewIndex.of(views), first, second, turns), centre=expected[:, :2]
    )
    assert np.median(same.z) > (3.0 if resolution_m < 0.2 else 2.0)
    off = np.hypot(*(same.transform - expected)[:, :2].T)
    assert np.median(off) < 0.2
