"""Which part of a world each run explores, so that runs overlap as planned."""

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
    """A connected set made larger, up to `size`, always by its neighbour of least cost.

    cost: (n,); vertices in `banned` are not taken. O(corridors log corridors).
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
    """Connected regions in a row: each shares about `overlap` of its vertices with the one before.

    The world is swept along several directions, and along the way from either end; the sweep whose
    overlaps come nearest wins.
    With `overlap` 0 the regions share nothing and leave a gap of one vertex.
    """

    def miss(regions: list[set[int]]) -> float:
        shares = [len(a & b) / size for a, b in pairwise(regions)]
        short = sum(size - len(region) for region in regions) / size + runs - len(regions)
        return round(sum(abs(share - overlap) for share in shares) + short, 9)

    directions = [0.0, np.pi, *chance.uniform(-0.25, 0.25, 4).tolist(), 0.5 * np.pi, -0.5 * np.pi]
    sweeps = [world.xy[:, 0] * np.cos(d) + world.xy[:, 1] * np.sin(d) for d in directions]
    sweeps += [_way_from(world, int(v)) for v in (np.argmin(sweeps[0]), np.argmax(sweeps[0]))]
    return min((_sweep(world, runs, size, overlap, sweep) for sweep in sweeps), key=miss)


def _way_from(world: World, vertex: int) -> FloatArray:
    """(n,) length of the shortest way from one vertex to each [m], rounded to a millimetre.

    Two corridors between the same vertices count as one of their joint length.
    """
    ends = (world.source, world.target)
    lengths = coo_matrix((world.length, ends), shape=(len(world), len(world)))
    way: FloatArray = dijkstra(lengths.tocsr(), directed=False, indices=[vertex])[0]
    rounded: FloatArray = np.round(way, 3)
    return rounded


def _sweep(world: World, runs: int, size: int, overlap: float, sweep: FloatArray) -> list[set[int]]:
    """Regions one after another along a coordinate of the vertices; fewer where room runs out."""
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
            # The shared part first, backwards into the last region, then onwards from all of it.
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
    """The first region along the sweep, clear of what is banned, that has room for `size`."""
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
    """The vertices one corridor away from a set."""
    return {other for v in region for _, other, _ in world.ends(v)} - region


def scattered_regions(world: World, runs: int, size: int, chance: Chance) -> list[set[int]]:
    """Discs of vertices around places that few runs have seen; overlap as it comes."""
    load = np.zeros(len(world))
    regions = []
    for _ in range(runs):
        options = chance.order(len(world))[:12]
        centre = int(options[np.argmin(load[options])])
        away = np.hypot(*(world.xy - world.xy[centre]).T)
        wanted = round(size * chance.one_uniform(0.8, 1.2))
        region = grown(world, {centre}, wanted, away, set())
        load[sorted(region)] += 1
        regions.append(region)
    return regions
