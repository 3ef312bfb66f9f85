"""Worlds of a dozen standard tiles, which repeat one another exactly.

Every seed uses the same tiles, rotated by quarter turns but not mirrored, so that different worlds
share junctions, angles and lengths and differ only in which tiles are neighbours.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from .chance import Chance
from .world import Link, World, without_bends, world_of_links

Point = tuple[int, int]
Tile = tuple[tuple[Point, ...], ...]
"""Corridors as polylines between points of a tile; openings are the midpoints of its sides."""

UNIT_M = 5.0
SIDE = 4
"""Side of a tile in units."""

TILES: tuple[Tile, ...] = (
    (((0, 2), (2, 2)), ((4, 2), (2, 2)), ((2, 0), (2, 2)), ((2, 4), (2, 2))),  # a crossing
    (((0, 2), (2, 2)), ((4, 2), (2, 2)), ((2, 0), (2, 2))),  # a tee
    (((0, 2), (1, 2)), ((1, 2), (1, 3)), ((1, 2), (4, 2))),  # straight on past a niche
    (((0, 2), (2, 2)), ((2, 2), (2, 4)), ((2, 2), (3, 2))),  # a corner with a blind end
    (((0, 2), (1, 2)), ((1, 2), (3, 2)), ((1, 2), (1, 3), (3, 3), (3, 2)), ((3, 2), (4, 2))),
    (((0, 2), (1, 2)), ((1, 2), (3, 2)), ((3, 2), (4, 2)), ((1, 2), (2, 4)), ((3, 2), (2, 0))),
    (((0, 2), (1, 2)), ((1, 2), (2, 1)), ((1, 2), (2, 3)), ((2, 1), (2, 0)), ((2, 3), (2, 4)),
     ((2, 1), (2, 3))),
    (((2, 0), (2, 1)), ((2, 1), (3, 1)), ((2, 1), (2, 3)), ((2, 3), (1, 3)), ((2, 3), (2, 4))),
    (((0, 2), (1, 1)), ((1, 1), (3, 1)), ((3, 1), (4, 2)), ((1, 1), (1, 3)), ((3, 1), (3, 3)),
     ((1, 3), (3, 3))),
    (((0, 2), (2, 3)), ((2, 3), (4, 2)), ((2, 3), (2, 1)), ((2, 1), (1, 1)), ((2, 1), (3, 1))),
    (((0, 2), (1, 2)), ((1, 2), (1, 1)), ((1, 2), (2, 4)), ((1, 2), (3, 2)), ((3, 2), (3, 1))),
    (((0, 2), (2, 3), (4, 2)), ((2, 0), (2, 1)), ((2, 1), (1, 1)), ((2, 1), (3, 1))),
)  # fmt: skip


def tiles_world(junctions: int, seed: int, aspect: float = 1.0) -> World:
    """About `junctions` junctions of adjacent TILES, each connected to those before it."""
    chance = Chance("tiles", seed)
    turned = [_turned(tile, quarter) for tile in TILES for quarter in range(4)]
    placed: dict[Point, Tile] = {(0, 0): TILES[0]}
    links = _links(placed)
    while _vertices(links) < junctions:
        cell = _next_cell(placed, aspect, chance)
        facing = {side for side in _SIDES if _leads(placed, cell, side)}
        walls = {side for side in _SIDES if _beyond(cell, side) in placed} - facing
        fits = [(t, _openings(t)) for t in turned if facing & _openings(t)]
        fewest = min(len(facing - o) + len(walls & o) for _, o in fits)
        fits = [f for f in fits if len(facing - f[1]) + len(walls & f[1]) <= fewest]
        placed[cell] = fits[chance.index(len(fits))][0]
        links = _links(placed)
    return _largest(f"tiles-{junctions}-{seed}", links)


_SIDES: tuple[Point, ...] = ((4, 2), (2, 4), (0, 2), (2, 0))
"""Openings of a tile: right, top, left, bottom."""


def _turned(tile: Tile, quarters: int) -> Tile:
    for _ in range(quarters):
        tile = tuple(tuple((SIDE - y, x) for x, y in path) for path in tile)
    return tile


def _openings(tile: Tile) -> set[Point]:
    ends = {p for path in tile for p in (path[0], path[-1])}
    return ends.intersection(_SIDES)


def _beyond(cell: Point, side: Point) -> Point:
    """The cell beyond an opening."""
    return cell[0] + side[0] // 2 - 1, cell[1] + side[1] // 2 - 1


def _leads(placed: dict[Point, Tile], cell: Point, side: Point) -> bool:
    """Whether the cell's neighbour beyond `side` has an opening towards it."""
    beside = placed.get(_beyond(cell, side))
    return beside is not None and (SIDE - side[0], SIDE - side[1]) in _openings(beside)


def _next_cell(placed: dict[Point, Tile], aspect: float, chance: Chance) -> Point:
    """A free cell beyond an opening: of three random ones, the nearest to the first tile."""
    free = sorted(
        {
            cell
            for at, tile in placed.items()
            for side in _openings(tile)
            if (cell := _beyond(at, side)) not in placed
        }
    )
    if not free:  # all is walled in
        at = max(placed)
        placed[at] = TILES[0]
        return at[0] + 1, at[1]
    some = [free[chance.index(len(free))] for _ in range(3)]
    return min(some, key=lambda c: (c[0] ** 2 / aspect + c[1] ** 2 * aspect, c))


def _links(placed: dict[Point, Tile]) -> list[tuple[Point, ...]]:
    """All corridors, in units of UNIT_M."""
    return [
        tuple((SIDE * i + x, SIDE * j + y) for x, y in path)
        for (i, j), tile in sorted(placed.items())
        for path in tile
    ]


def _vertices(links: list[tuple[Point, ...]]) -> int:
    """Number of points connected to the first tile's centre at which other than two corridors
    end."""
    count: dict[Point, int] = defaultdict(int)
    joined = DisjointSet({p for path in links for p in (path[0], path[-1])})
    for path in links:
        count[path[0]] += 1
        count[path[-1]] += 1
        joined.merge(path[0], path[-1])
    return sum(count[p] != 2 for p in joined.subset((2, 2)))


def _largest(name: str, paths: list[tuple[Point, ...]]) -> World:
    """The world of the largest connected part; bends and openings are no junctions."""
    points = sorted({p for path in paths for p in (path[0], path[-1])})
    number = {p: k for k, p in enumerate(points)}
    xy = UNIT_M * np.array(points, np.float64)
    links: list[Link] = [
        (number[path[0]], number[path[-1]], UNIT_M * np.array(path, np.float64)) for path in paths
    ]
    return world_of_links(name, "tiles", xy, without_bends(links))
