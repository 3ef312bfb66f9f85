"""Worlds of every kind."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from topobatch.simulation.chance import Chance
from topobatch.simulation.settings import Faults, WalkSettings
from topobatch.simulation.walk import explore
from topobatch.simulation.worlds import make_world

from .driven import KINDS

WORLDS = {
    ("maze", 40, 3): "84a167cd3fd76cd7",
    ("maze", 120, 7): "f9569030c5a96b26",
    ("office", 40, 3): "784717c0e3f8d2c9",
    ("office", 120, 7): "876afffc2a97a426",
    ("organic", 40, 3): "3d0390f0019595bd",
    ("organic", 120, 7): "0415f472126ba25d",
    ("city", 40, 3): "5d8ec485cbdedc48",
    ("city", 120, 7): "ac0893ad3d1044ff",
    ("rows", 40, 3): "78b2d219cb188994",
    ("rows", 120, 7): "ef2cfacda3b33650",
    ("tiles", 40, 3): "dbd81b85a935d405",
    ("tiles", 120, 7): "9e66a275b03d5d30",
}
"""Digests of worlds by kind, junctions and seed: records of benchmarks hang on them."""


@pytest.mark.parametrize(("kind", "junctions", "seed"), WORLDS)
def test_the_same_seed_gives_the_same_world_on_any_machine(kind, junctions, seed) -> None:
    world = make_world(kind, junctions, seed, aspect=1.0 if junctions == 40 else 2.0)
    digest = hashlib.sha256()
    for part in (world.xy, world.source, world.target, np.concatenate(world.paths)):
        digest.update((np.round(np.asarray(part, float), 6) + 0.0).tobytes())
    assert digest.hexdigest()[:16] == WORLDS[kind, junctions, seed]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("junctions", [15, 120])
def test_worlds_are_connected_and_of_the_size_asked(kind: str, junctions: int) -> None:
    world = make_world(kind, junctions, seed=4, aspect=2.0)
    assert abs(len(world) - junctions) <= max(0.15 * junctions, 25 if kind == "office" else 8)
    legs, _ = explore(world, set(range(len(world))), WalkSettings(1.0), Faults(), Chance(1))
    assert {leg.target for leg in legs} | {legs[0].source} == set(range(len(world)))
    assert np.all(world.length > 2.0)
    np.testing.assert_array_equal(world.branches.counts > 0, True)


def test_worlds_of_tiles_repeat_each_other() -> None:
    worlds = [make_world("tiles", 100, seed) for seed in (1, 2)]
    assert worlds[0].xy.shape != worlds[1].xy.shape
    lengths = [set(np.round(world.length, 6)) for world in worlds]
    assert len(lengths[0] & lengths[1]) > 0.7 * min(map(len, lengths))
    for world in worlds:
        np.testing.assert_array_equal(world.xy % 5.0, 0.0)
        assert np.mean(world.branches.counts >= 3) > 0.5
