"""Saved maps: read as map_server reads them, hostile ones refused, drawn as junctions and ways."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from topobatch.ingest.grid_map import map_of_grid
from topobatch.ingest.logs.grids import GridLog
from topobatch.merge.merging import merge_maps
from topobatch.simulation.walls import free_space
from topobatch.simulation.world import World, polyline_at
from topobatch.simulation.worlds import make_world
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.errors import DataError
from topobatch.topology.polyline import densely
from topobatch.topology.run import Grid
from topobatch.topology.se2 import apply, fit_rigid
from topobatch.topology.topomap import TopoMap

# --- maps --------------------------------------------------------------------------------------


def grid_of(world: World, seen: set[int] | None = None, resolution: float = 0.05) -> Grid:
    """What a perfect mapper would save of a world, or of what is seen from some vertices of it:
    their junctions, and the corridors there half-way to the next ones.
    """
    polygons = free_space(world, 1.4)
    low = np.min([p.min(axis=0) for p in polygons], axis=0) - 1
    high = np.max([p.max(axis=0) for p in polygons], axis=0) + 1
    width, height = np.ceil((high - low) / resolution).astype(int).tolist()
    picture = Image.new("L", (width, height), 0)
    pen = ImageDraw.Draw(picture)
    for polygon in polygons:
        pen.polygon([tuple(p) for p in (polygon - low) / resolution], fill=1)
    free = np.asarray(picture) > 0
    walls = binary_dilation(free, iterations=3) & ~free
    if seen is not None:
        rows = np.argwhere(free)
        ways = [
            polyline_at(p, np.linspace(0, n, 50))
            for p, n in zip(world.paths, world.length, strict=True)
        ]
        owner = np.concatenate(
            [
                np.repeat([int(world.source[e]), int(world.target[e])], 25)
                for e in range(len(world.source))
            ]
        )
        _, nearest = cKDTree(np.concatenate(ways)).query(rows[:, ::-1] * resolution + low)
        kept = np.isin(owner[nearest], sorted(seen))
        free = np.zeros_like(free)
        free[tuple(rows[kept].T)] = True
        walls &= binary_dilation(free, iterations=5)
    return Grid(free, ~free & ~walls, resolution, (float(low[0]), float(low[1]), 0.0))


def topomap(name: str, grid: Grid) -> TopoMap:
    found = map_of_grid(GridLog(name, grid, {"junctions": {"from": "grid", "topic": name}}))
    return replace(map_from_document(map_to_document(found)), views=found.views)


@pytest.mark.parametrize("kind", ["office", "organic"])
def test_a_grid_shows_the_junctions_of_its_world(kind: str) -> None:
    world = make_world(kind, 40, 5)
    found = topomap(kind, grid_of(world))
    there = np.flatnonzero(world.branches.counts >= 3)
    gap = np.hypot(*(found.xy[:, None] - world.xy[there][None]).transpose(2, 0, 1))
    seen = gap.min(axis=0) < 1.0
    assert seen.mean() >= 0.95, f"{seen.sum()} of {len(there)}"
    of_junctions = np.array([k == "junction" for k in found.kind])
    right = gap[of_junctions].min(axis=1) < 1.0
    # Where streets part at an acute angle, the free space between them makes nodes of its own.
    least = 0.9 if kind == "organic" else 0.95
    assert right.mean() >= least, f"{right.sum()} of {of_junctions.sum()}"
    degree = world.branches.counts[there][gap.argmin(axis=1)]
    right = (found.degree == degree)[of_junctions]
    assert right.mean() >= (0.85 if kind == "organic" else 0.95), f"{right.sum()} of {len(right)}"
    assert not found.shows_bends


def turned(grid: Grid) -> Grid:
    free, unknown = np.rot90(grid.free), np.rot90(grid.unknown)
    return Grid(free, unknown, grid.resolution_m, (3.0, 4.0, 0.7))


@pytest.mark.parametrize("kind", ["maze", pytest.param("city", marks=pytest.mark.slow)])
def test_two_halves_of_a_world_merge_and_strangers_do_not(kind: str) -> None:
    world = make_world(kind, 60, 151)
    order = np.argsort(world.xy[:, 0])
    left, right = (
        set(part.tolist()) for part in (order[: len(order) * 2 // 3], order[len(order) // 3 :])
    )
    parts = grid_of(world, left, 0.1), turned(grid_of(world, right, 0.1))
    maps = [topomap(name, part) for name, part in zip(("left", "right"), parts, strict=True)]
    others = [grid_of(make_world(kind, 40, 100 + k), None, 0.1) for k in range(6)]
    maps += [topomap(f"other{k}", other) for k, other in enumerate(others)]
    result = merge_maps(maps)
    verdicts = {(p.a, p.b): p.verdict for p in result.verdicts}
    assert verdicts.pop(("left", "right")) == "merged"
    assert set(verdicts.values()) <= {"unrelated", "ambiguous"}


def test_a_grid_without_junctions(tmp_path: Path) -> None:
    corridor = np.zeros((20, 200), bool)
    corridor[5:15, 5:195] = True
    for free in (corridor, np.zeros((5, 5), bool)):
        with pytest.raises(DataError, match="shows no junction"):
            map_of_grid(GridLog("x", Grid(free, ~free, 0.1, (0.0, 0.0, 0.0)), {}))


def test_the_widest_place_stands_for_a_hall_without_junctions() -> None:
    free = np.zeros((220, 320), bool)
    free[10:210, 10:310] = True
    hall = map_of_grid(GridLog("hall", Grid(free, ~free, 0.05, (3.0, 4.0, 0.0)), {}))
    assert hall.kind == ("room",)
    assert hall.area_m2 == pytest.approx([150.0])
    assert np.abs(hall.xy - (3 + 8, 4 + 5.5)).max() < 2.6
    assert len(hall.views) > 0
    (told,) = hall.info["warnings"]
    assert "its widest place stands for one" in told


def test_the_origin_places_the_map() -> None:
    grid = grid_of(make_world("maze", 20, 4))
    plain = topomap("a", grid._replace(origin=(0.0, 0.0, 0.0)))
    moved = topomap("a", grid._replace(origin=(5.0, -3.0, 1.0)))
    np.testing.assert_allclose(moved.xy, apply(np.array([5.0, -3.0, 1.0]), plain.xy), atol=2e-3)
    np.testing.assert_allclose(fit_rigid(moved.xy, plain.xy), (5.0, -3.0, 1.0), atol=2e-3)
    np.testing.assert_array_equal(moved.degree, plain.degree)


def pillars() -> Grid:
    """A room of 6 x 6 m with nine round pillars, 1.1 m from each other."""
    y, x = np.mgrid[-3:3:0.05, -3:3:0.05]
    free = (np.abs(x) < 2.4) & (np.abs(y) < 2.4)
    for a in (-1.1, 0.0, 1.1):
        for b in (-1.1, 0.0, 1.1):
            free &= np.hypot(x - a, y - b) > 0.15
    return Grid(free, np.zeros_like(free), 0.05, (-3.0, -3.0, 0.0))


def test_a_room_with_pillars_has_junctions_between_them() -> None:
    found = topomap("pillars", pillars())
    between = np.array([(x, y) for x in (-0.55, 0.55) for y in (-0.55, 0.55)])
    away = np.hypot(*(found.xy[:, None] - between[None]).transpose(2, 0, 1)).min(axis=0)
    assert away.max() < 0.2
    for path in found.paths:
        for a in (-1.1, 0.0, 1.1):
            for b in (-1.1, 0.0, 1.1):
                assert np.hypot(*(densely(path, 0.02) - (a, b)).T).min() > 0.15 + 0.2


def test_a_home_with_narrow_doors_is_mapped_for_a_smaller_robot() -> None:
    """Two rooms on either side of a hall with a door in it, all doors of 0.4 m."""
    free = np.zeros((160, 240), bool)
    free[60:100, 20:220] = True
    for left in (30, 130):
        for low, high in ((5, 57), (103, 155)):
            free[low:high, left : left + 70] = True
            free[57:103, left + 31 : left + 39] = True
    free[60:100, 100:104] = False
    free[76:84, 100:104] = True
    home = GridLog("home", Grid(free, np.zeros_like(free), 0.05, (0.0, 0.0, 0.0)), {})
    m = topomap(home.name, home.grid)
    assert (m.kind.count("room"), m.kind.count("door")) == (6, 5)
    assert m.area_m2 is not None
    assert m.width_m is not None
    np.testing.assert_array_equal(m.area_m2 > 0, [kind == "room" for kind in m.kind])
    np.testing.assert_allclose(m.width_m[m.width_m > 0], 0.4, atol=0.08)
    assert any("narrower doors" in warning for warning in m.info["warnings"])
