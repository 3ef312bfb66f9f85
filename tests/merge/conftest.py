"""Maps to merge: random mazes, parts of simulated worlds seen with noise, a small building drawn by
hand."""

from __future__ import annotations

import importlib.util
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from topobatch.simulation.worlds import make_world

from ..maps import straight_map

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def _benchmark(name):
    """A module of the benchmarks, which stand in no package."""
    spec = importlib.util.spec_from_file_location(f"topobatch_{name}", BENCHMARKS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


OBSERVED = _benchmark("observed")


@pytest.fixture(scope="session")
def mazes():
    """The module that the benchmarks draw random mazes with."""
    return _benchmark("mazes")


@pytest.fixture(scope="session")
def draw():
    """`straight_map`, passed once."""
    return straight_map


@pytest.fixture(scope="session")
def drawn():
    """`straight_map`, passed three times."""
    return partial(straight_map, sigma=0.1, passes=3)


@pytest.fixture(scope="session")
def maze_pair(mazes):
    """A function (seed, size=40, overlap=0.4) to two maps of a maze and their common vertices."""

    def pair(seed, size=40, overlap=0.4, noise=0.01, turn=0.7):
        rng = np.random.default_rng(seed)
        maze = mazes.random_maze(rng, 11, 11)
        regions = mazes.overlapping_regions(maze, rng, size, overlap)
        error = mazes.Noise(floor_m=noise, share=0.0)
        a = mazes.explored_map(maze, regions[0], rng, "a", noise=error)
        b = mazes.explored_map(maze, regions[1], rng, "b", noise=error, turn=turn)
        common = sorted(set(regions[0]) & set(regions[1]))
        truth = np.array([[r.index(v) for r in regions] for v in common], np.int64)
        return a, b, truth

    return pair


@pytest.fixture(scope="session")
def see():
    """see(world, vertices, seed, name, **seeing) -> TopoMap; info["truth"]: its world vertices."""

    def see(world, vertices, seed, name, **seeing):
        noise = OBSERVED.Seeing(**seeing)
        return OBSERVED.observed_map(world, vertices, np.random.default_rng(seed), name, noise)

    return see


@pytest.fixture(scope="session")
def maze():
    return make_world("maze", 110, 3)


@pytest.fixture
def side_by_side(maze, see):
    """Two maps that share a few junctions only, too few to tell: maps a and b, and the numbers of a
    junction of both."""
    across = maze.xy[:, 0]
    a = see(maze, np.flatnonzero(across < np.quantile(across, 0.5)).tolist(), 1, "a", missed=0.0)
    shared = sorted(a.info["truth"], key=lambda v: -across[v])[:3]
    beyond = np.flatnonzero(across > np.quantile(across, 0.5)).tolist()
    b = see(maze, sorted({*shared, *beyond}), 2, "b", missed=0.0)
    vertex = next(v for v in shared if v in b.info["truth"])
    at = (a.info["truth"].index(vertex), b.info["truth"].index(vertex))
    return a, b, at


@pytest.fixture(scope="session")
def other_maze():
    return make_world("maze", 110, 4)


@pytest.fixture(scope="session")
def halves(maze, see):
    """Two maps of one maze that share the columns in its middle."""
    across = maze.xy[:, 0]
    left = np.flatnonzero(across < np.quantile(across, 0.6))
    right = np.flatnonzero(across > np.quantile(across, 0.3))
    return see(maze, left.tolist(), 1, "left"), see(maze, right.tolist(), 2, "right")


@pytest.fixture(scope="session")
def right_matches():
    """right_matches(matched, a, b) -> share of the pairs (vertex of a, of b) that are true."""

    def share(matched, a, b):
        return np.mean([a.info["truth"][i] == b.info["truth"][j] for i, j in np.asarray(matched)])

    return share
