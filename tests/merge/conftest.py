"""Maps to merge: random mazes, and a small building drawn by hand."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, wrap
from topobatch.topology.topomap import TopoMap

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="session")
def mazes():
    """The module that the benchmarks draw random mazes with."""
    spec = importlib.util.spec_from_file_location("topobatch_mazes", BENCHMARKS / "mazes.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def drawn(run, corners, corridors, stubs=(), *, T=(0.0, 0.0, 0.0), sigma=0.05, lengths=None):
    """A map from vertex positions {name: (x, y)}, corridors (name, name) and unexplored branches
    (name, heading), moved by T. Corridors are straight. `lengths` overrides what was measured.
    """
    names = list(corners)
    xy = np.array([corners[n] for n in names], float).reshape(-1, 2)
    rows = [[] for _ in names]
    ends = [(names.index(u), names.index(v)) for u, v in corridors]

    def heading(u, v):
        return float(np.arctan2(*(xy[v] - xy[u])[::-1]))

    for u, v in ends:
        rows[u].append(heading(u, v))
        rows[v].append(heading(v, u))
    for name, direction in stubs:
        rows[names.index(name)].append(direction)
    rows = [np.sort(wrap(np.array(r) + T[2])) for r in rows]

    def branch(u, v):
        return int(np.abs(wrap(rows[u] - heading(u, v) - T[2])).argmin())

    moved = apply(np.array(T), xy)
    length = np.array([np.hypot(*(xy[v] - xy[u])) for u, v in ends])
    for (u, v), value in (lengths or {}).items():
        length[corridors.index((u, v))] = value
    return TopoMap(
        run=run,
        frame="odom",
        xy=moved,
        branches=Ragged.from_rows(rows),
        kind=tuple("dead_end" if len(r) == 1 else "junction" for r in rows),
        source=np.array([u for u, _ in ends], np.int64),
        target=np.array([v for _, v in ends], np.int64),
        source_branch=np.array([branch(u, v) for u, v in ends], np.int64),
        target_branch=np.array([branch(v, u) for u, v in ends], np.int64),
        length=length,
        length_sigma=np.full(len(ends), sigma),
        traversals=np.ones(len(ends), np.int64),
        paths=tuple(moved[[u, v]] for u, v in ends),
        observation_vertex=np.arange(len(names)),
        observation_time_ns=np.arange(len(names)) * 10**9,
    )


@pytest.fixture(scope="session")
def draw():
    return drawn


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
