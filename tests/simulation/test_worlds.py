"""Worlds of every kind."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.simulation import Faults, WalkSettings, make_world
from topobatch.simulation.chance import Chance
from topobatch.simulation.walk import explore
from topobatch.simulation.world import polyline_heading
from topobatch.topology.se2 import wrap

from .driven import KINDS


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("junctions", [15, 120])
def test_worlds_are_connected_and_of_the_size_asked(kind: str, junctions: int) -> None:
    world = make_world(kind, junctions, seed=4, aspect=2.0)
    assert abs(len(world) - junctions) <= max(0.15 * junctions, 25 if kind == "office" else 8)
    legs, _ = explore(world, set(range(len(world))), WalkSettings(1.0), Faults(), Chance(1))
    assert {leg.target for leg in legs} | {legs[0].source} == set(range(len(world)))
    assert np.all(world.length > 2.0)
    np.testing.assert_array_equal(world.branches.counts > 0, True)


@pytest.mark.parametrize("kind", ["maze", "office"])
def test_mazes_and_offices_turn_at_right_angles(kind: str) -> None:
    headings = make_world(kind, 80, seed=1).branches.values
    assert np.max(np.abs(wrap(4 * headings))) < 1e-6


def test_streets_leave_a_junction_apart_and_bend_without_one() -> None:
    world = make_world("organic", 150, seed=2)
    rows = [np.sort(world.branches[v]) for v in range(len(world))]
    gaps = [np.min(np.diff(np.append(r, r[0] + 2 * np.pi))) for r in rows if len(r) > 1]
    assert min(gaps) > np.radians(35)
    assert np.count_nonzero(world.branches.counts == 2) < 4
    assert any(len(path) > 2 for path in world.paths)


def test_city_blocks_are_square_at_every_crossing_and_not_as_a_whole() -> None:
    world = make_world("city", 120, seed=2)
    rows = [world.branches[v] for v in range(len(world))]
    square = [np.abs(wrap(4 * np.diff(r))) / 4 for r in rows if len(r) > 1]
    assert np.quantile(np.concatenate(square), 0.9) < np.radians(15)
    whole = np.abs(np.exp(4j * world.branches.values).mean())
    alone = np.mean([np.abs(np.exp(4j * r).mean()) for r in rows])
    assert alone > 0.9
    assert whole < 0.8


def test_wings_of_an_office_repeat_one_plan() -> None:
    world = make_world("office", 200, seed=5)
    degree = world.branches.counts
    assert np.count_nonzero(degree == 1) > 40
    assert np.std(world.length[np.abs(world.length - 4.2) < 0.5]) < 0.15


def test_worlds_of_tiles_repeat_each_other() -> None:
    worlds = [make_world("tiles", 100, seed) for seed in (1, 2)]
    assert worlds[0].xy.shape != worlds[1].xy.shape
    lengths = [set(np.round(world.length, 6)) for world in worlds]
    assert len(lengths[0] & lengths[1]) > 0.7 * min(map(len, lengths))
    for world in worlds:
        np.testing.assert_array_equal(world.xy % 5.0, 0.0)
        assert np.mean(world.branches.counts >= 3) > 0.5


def test_rows_are_equal() -> None:
    world = make_world("rows", 80, seed=3)
    along = np.isclose(np.abs(np.sin([polyline_heading(p) for p in world.paths])), 1.0)
    assert np.count_nonzero(along) > 20
    np.testing.assert_allclose(world.length[along] / 30.0, np.rint(world.length[along] / 30.0))
    step = world.length[~along] / 3.0
    assert np.abs(step - np.rint(step)).max() < 0.15
