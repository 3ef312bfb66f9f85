"""The part of a world that each run explores, for a given overlap of runs."""

from __future__ import annotations

import heapq
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from ..topology.arrays import FloatArray
from .chance import Chance
from .world import World


def grown(
    world: World, inside: set[int], size: int, cost: FloatArray, banned: set[int]
) -> set[int]:
    """A connected set of vertices grown to `size`, by the neighbour of least cost each time.

    cost: (n,); vertices in `banned` are not added. O(corridors log corridors).
    """
    region = set(inside)
    heap = [(float(cost[v]), v) for v in _beside(world, region) - banned]
    heapq.heapify(heap)
    while heap and len(region) < size:
        _, vertex = heapq.heappop(heap)
        if vertex in region:
            continue
        region.add(vertex)
        for _, other, _ in world.ends(vertex):
            if other not in region and other not in banned:
                heapq.heappush(heap, (float(cost[other]), other))
    return region


def chain_of_regions(
    world: World, runs: int, size: int, overlap: float, chance: Chance
) -> list[set[int]]:
    """Connected regions in a row, each sharing about `overlap` of its vertices with the one before.

    Several sweeps over the world are tried, in directions of the plane and by distance from either
    end; the one whose overlaps are nearest is taken. With `overlap` 0 regions are disjoint, with a
    gap of one vertex.
    """

    def miss(regions: list[set[int]]) -> float:
        shares = [len(a & b) / size for a, b in pairwise(regions)]
        short = sum(size - len(region) for region in regions) / size + runs - len(regions)
        return round(sum(abs(share - overlap) for share in shares) + short, 9)

    directions = [0.0, np.pi, *chance.around(0.25, 4).tolist(), 0.5 * np.pi, -0.5 * np.pi]
    sweeps = [world.xy[:, 0] * np.cos(d) + world.xy[:, 1] * np.sin(d) for d in directions]
    sweeps += [_way_from(world, int(v)) for v in (np.argmin(sweeps[0]), np.argmax(sweeps[0]))]
    return min((_sweep(world, runs, size, overlap, sweep) for sweep in sweeps), key=miss)


def _way_from(world: World, vertex: int) -> FloatArray:
    """(n,) shortest path length from a vertex to each [m], rounded to a millimetre.

    Parallel corridors count as one with the sum of their lengths.
    """
    ends = (world.source, world.target)
    lengths = coo_matrix((world.length, ends), shape=(len(world), len(world)))
    way: FloatArray = dijkstra(lengths.tocsr(), directed=False, indices=[vertex])[0]
    rounded: FloatArray = np.round(way, 3)
    return rounded


def _sweep(world: World, runs: int, size: int, overlap: float, sweep: FloatArray) -> list[set[int]]:
    """Regions in order of a coordinate of the vertices; fewer than asked if the world is too
    small."""
    regions = [grown(world, {int(np.argmin(sweep))}, size, sweep, set())]
    used = set(regions[0])
    common = round(overlap * size)
    while len(regions) < runs:
        last = regions[-1]
        if common == 0:
            region = _apart(world, size, sweep, used | _beside(world, used))
        else:
            fresh = _beside(world, last) - used
            if not fresh:
                break
            start = min(sorted(fresh), key=lambda v: float(sweep[v]))
            # First the shared part, backwards into the last region, then the rest onwards from it.
            allowed = last - set.union(set(), *regions[:-1])
            allowed = allowed if len(allowed) >= common else last
            outside = set(range(len(world))) - allowed - {start}
            shared = grown(world, {start}, common + 1, -sweep, outside)
            region = grown(world, shared, size, sweep, used - shared)
        if not region:
            break
        regions.append(region)
        used |= region
    return regions


def _apart(world: World, size: int, sweep: FloatArray, banned: set[int]) -> set[int]:
    """The first region of `size` along the sweep without banned vertices; else the largest."""
    best: set[int] = set()
    tried: set[int] = set()
    for start in np.argsort(sweep, kind="stable").tolist():
        if start not in banned and start not in tried:
            region = grown(world, {start}, size, sweep, banned)
            tried |= region
            if len(region) > len(best):
                best = region
            if len(best) == size:
                break
    return best


def _beside(world: World, region: set[int]) -> set[int]:
    """The neighbours of a set of vertices."""
    return {other for v in region for _, other, _ in world.ends(v)} - region
