"""Random maze-like worlds and the maps of robots that explored parts of them, as maps, not logs."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from topobatch.topology.matching.structure import grid_direction
from topobatch.topology.passes import NO_BRANCH
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, rotation, wrap
from topobatch.topology.topomap import TopoMap

HEADINGS = np.array([-np.pi, -np.pi / 2, 0.0, np.pi / 2])

ACROSS_M = 0.03
"""A straight corridor keeps its line to this, 1 sigma."""


@dataclass(frozen=True)
class Maze:
    """A rectilinear world: vertices, and per edge its ends and the slots (0..3) it leaves by."""

    xy: NDArray[np.float64]
    source: NDArray[np.int64]
    target: NDArray[np.int64]
    source_slot: NDArray[np.int64]
    target_slot: NDArray[np.int64]


@dataclass(frozen=True)
class Noise:
    """Odometry error model of a length: sqrt(floor² + (share · length)²), 1 sigma."""

    floor_m: float = 0.05
    share: float = 0.005


def random_maze(rng, rows, columns, *, extra=0.25, low_m=3.0, high_m=8.0):
    """A spanning tree of a grid with uneven spacing, plus some of the walls taken out again.

    Straight passages are corridors, not vertices.
    """
    x = np.concatenate([[0.0], np.cumsum(rng.uniform(low_m, high_m, columns - 1))])
    y = np.concatenate([[0.0], np.cumsum(rng.uniform(low_m, high_m, rows - 1))])
    cell = np.arange(rows * columns).reshape(rows, columns)
    right = np.column_stack(
        [cell[:, :-1].ravel(), cell[:, 1:].ravel(), np.full(rows * (columns - 1), 2)]
    )
    up = np.column_stack([cell[:-1].ravel(), cell[1:].ravel(), np.full((rows - 1) * columns, 3)])
    walls = rng.permutation(np.concatenate([right, up]))
    head = np.arange(rows * columns)

    def root(v):
        while head[v] != v:
            head[v] = head[head[v]]
            v = head[v]
        return v

    opened = np.full((rows * columns, 4), -1)
    for u, v, slot in walls.tolist():
        p, q = root(u), root(v)
        if p != q or rng.random() < extra:
            head[p] = q
            opened[u, slot], opened[v, (slot + 2) % 4] = v, u
    degree = (opened >= 0).sum(axis=1)
    straight = (degree == 2) & ((opened[:, 0] >= 0) == (opened[:, 2] >= 0))
    number = np.cumsum(~straight) - 1
    edges = []
    for u in np.flatnonzero(~straight).tolist():
        for slot in (2, 3):
            v = opened[u, slot]
            if v >= 0:
                while straight[v]:
                    v = opened[v, slot]
                edges.append((number[u], number[v], slot, (slot + 2) % 4))
    where = np.column_stack([np.tile(x, rows), np.repeat(y, columns)])[~straight]
    return Maze(where, *np.array(edges, np.int64).T)


def overlapping_regions(maze, rng, size, overlap):
    """Two connected regions of `size` vertices with a share `overlap` of them in common.

    Both grow from a common core, one to the left and one to the right of the world.
    """
    neighbours = [[] for _ in maze.xy]
    for u, v in zip(maze.source.tolist(), maze.target.tolist(), strict=True):
        neighbours[u].append(v)
        neighbours[v].append(u)
    across, spread = maze.xy[:, 0], np.ptp(maze.xy[:, 0])
    middle = np.abs(across - across.mean()) + rng.uniform(0, 0.2 * spread, len(across))
    core = grown(neighbours, [int(middle.argmin())], max(1, round(size * overlap)), middle, set())
    left = grown(neighbours, core, size, across + rng.uniform(0, 0.1 * spread, len(across)), set())
    banned = set(left) - set(core)
    cost = -across + rng.uniform(0, 0.1 * spread, len(across))
    return left, grown(neighbours, core, size, cost, banned)


def separate_regions(maze, size):
    """Two connected regions of at most `size` vertices, on the left and on the right, that share
    none."""
    neighbours = [[] for _ in maze.xy]
    for u, v in zip(maze.source.tolist(), maze.target.tolist(), strict=True):
        neighbours[u].append(v)
        neighbours[v].append(u)
    across = maze.xy[:, 0]
    left = grown(neighbours, [int(across.argmin())], size, across, set())
    free = np.setdiff1d(np.arange(len(across)), left)
    start = int(free[across[free].argmax()])
    return left, grown(neighbours, [start], size, -across, set(left))


def grown(neighbours, seed, size, cost, banned):
    """A connected region from `seed` on, cheapest frontier vertex first."""
    found = set(seed)
    frontier = [(float(cost[w]), w) for v in seed for w in neighbours[v]]
    heapq.heapify(frontier)
    while frontier and len(found) < size:
        _, v = heapq.heappop(frontier)
        if v not in found and v not in banned:
            found.add(v)
            for w in neighbours[v]:
                heapq.heappush(frontier, (float(cost[w]), w))
    return sorted(found)


def spanning_edges(maze, edges):
    """Edges of a spanning forest of the given ones."""
    head = np.arange(len(maze.xy))

    def root(v):
        while head[v] != v:
            v = head[v]
        return v

    found = set()
    for e in edges:
        p, q = root(int(maze.source[e])), root(int(maze.target[e]))
        if p != q:
            head[p] = q
            found.add(e)
    return found


def explored_map(maze, region, rng, name, *, noise=Noise(), turn=0.0, skipped=0.05):
    """The map of a robot that drove the corridors inside a region, in a frame turned by `turn`.

    Some corridors (`skipped`) were not driven, but the map hangs together; corridors that lead
    out are unexplored branches.
    """
    inside = {v: k for k, v in enumerate(region)}
    keep = [
        e
        for e, (u, v) in enumerate(zip(maze.source.tolist(), maze.target.tolist(), strict=True))
        if u in inside and v in inside
    ]
    needed = spanning_edges(maze, keep)
    keep = [e for e in keep if e in needed or rng.random() >= skipped]
    slots = [set() for _ in maze.xy]
    for e in range(len(maze.source)):
        slots[maze.source[e]].add(int(maze.source_slot[e]))
        slots[maze.target[e]].add(int(maze.target_slot[e]))
    rows, place = [], []
    for v in region:
        mine = sorted(slots[v])
        moved = wrap(HEADINGS[mine] + turn)
        order = np.argsort(moved)
        rows.append(moved[order])
        place.append({mine[k]: int(rank) for rank, k in enumerate(order)})
    source = np.array([inside[int(u)] for u in maze.source[keep]], np.int64)
    target = np.array([inside[int(v)] for v in maze.target[keep]], np.int64)
    true = np.hypot(*(maze.xy[maze.target[keep]] - maze.xy[maze.source[keep]]).T)
    sigma = np.hypot(noise.floor_m, noise.share * true)
    length = np.maximum(true + rng.normal(0, 1, len(true)) * sigma, 0.1)
    turned = apply(np.array([0.0, 0.0, turn]), maze.xy[region])
    drawn = TopoMap(
        run=name,
        frame="odom",
        xy=turned,
        branches=Ragged.from_rows(rows),
        kind=tuple("dead_end" if len(r) == 1 else "junction" for r in rows),
        source=source,
        target=target,
        source_branch=np.array(
            [place[u][int(s)] for u, s in zip(source, maze.source_slot[keep], strict=True)],
            np.int64,
        ),
        target_branch=np.array(
            [place[v][int(s)] for v, s in zip(target, maze.target_slot[keep], strict=True)],
            np.int64,
        ),
        length=length,
        length_sigma=sigma,
        traversals=np.ones(len(keep), np.int64),
        paths=tuple(turned[[u, v]] for u, v in zip(source, target, strict=True)),
        observation_vertex=np.arange(len(region)),
        observation_time_ns=np.arange(len(region)) * 10**9,
    )
    return embedded(drawn)


def embedded(topomap):
    """The map with its vertices where its own measurements put them (§3.1)."""
    xy = embed_rectilinear(topomap)
    paths = tuple(xy[[u, v]] for u, v in zip(topomap.source, topomap.target, strict=True))
    return replace(topomap, xy=xy, paths=paths)


def embed_springs(
    count: int,
    ends: tuple[NDArray[np.int64], NDArray[np.int64]],
    displacement: NDArray[np.float64],
    sigma: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(count,) positions on a line that fit displacements between pairs best, by least squares.

    ends: source and target (k,) of every spring; displacement: (k,) target minus source [m];
    sigma: (k,) 1 sigma [m]. The first vertex of every connected part is at 0. One sparse
    factorisation of the weighted graph Laplacian.
    """
    source, target = ends
    weight = sigma**-2.0
    rows = np.concatenate([source, target, source, target])
    columns = np.concatenate([source, target, target, source])
    values = np.concatenate([weight, weight, -weight, -weight])
    laplacian = csc_array(coo_array((values, (rows, columns)), shape=(count, count)))
    pull = weight * displacement
    right = np.bincount(target, pull, count) - np.bincount(source, pull, count)
    _, part = connected_components(laplacian, directed=False)
    _, first = np.unique(part, return_index=True)
    free = np.ones(count, bool)
    free[first] = False
    out = np.zeros(count)
    if free.any():
        index = np.flatnonzero(free)
        out[index] = splu(csc_array(laplacian[index][:, index])).solve(right[index])
    return out


def embed_rectilinear(topomap: TopoMap) -> NDArray[np.float64]:
    """(n, 2) positions [m] in the map's directions by two decoupled spring problems (§3.3).

    A straight corridor measures its length along its axis and nothing moves across it; one that
    bends measures the displacement of its path. Raises ValueError if the map is not rectilinear.
    """
    grid = grid_direction(topomap.branches.values)
    if grid is None:
        raise ValueError(f"map {topomap.run!r} is not rectilinear")
    step, straight = _grid_steps(topomap, grid)
    way = np.abs(step).sum(axis=1)
    share = np.sqrt(np.abs(step) / np.maximum(way, 1e-9)[:, None])
    sigma = np.hypot(topomap.length_sigma[:, None] * share, ACROSS_M)
    sigma[straight] = np.where(
        np.abs(step[straight]) > 0, topomap.length_sigma[straight, None], ACROSS_M
    )
    ends = (topomap.source, topomap.target)
    axes = [embed_springs(len(topomap), ends, step[:, k], sigma[:, k]) for k in range(2)]
    return np.asarray(np.column_stack(axes) @ rotation(grid).T)


def _grid_steps(topomap: TopoMap, grid_rad: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Displacement (m, 2) of every corridor along the two axes of the grid; which are straight."""
    chord = np.array([p[-1] - p[0] for p in topomap.paths]).reshape(-1, 2) @ rotation(grid_rad)
    drawn = np.array([np.hypot(*np.diff(p, axis=0).T).sum() for p in topomap.paths])
    step = chord * (topomap.length / np.maximum(drawn, 1e-9))[:, None]
    headings = np.full((len(step), 2), np.nan)
    for column, (end, branch) in enumerate(
        ((topomap.source, topomap.source_branch), (topomap.target, topomap.target_branch))
    ):
        known = branch != NO_BRANCH
        rows = topomap.branches.offsets[end[known]] + branch[known]
        headings[known, column] = topomap.branches.values[rows] - grid_rad
    quarter = np.rint(headings / (np.pi / 2))
    with np.errstate(invalid="ignore"):
        straight = (quarter[:, 0] - quarter[:, 1]) % 4 == 2
    straight &= topomap.source != topomap.target
    angle = quarter[straight, 0] * (np.pi / 2)
    axis = np.rint(np.column_stack([np.cos(angle), np.sin(angle)]))
    step[straight] = topomap.length[straight, None] * axis
    return step, straight
