"""Kinds of world: rectilinear mazes, repetitive offices, organic streets, city blocks, equal rows.

Corners count as junctions in mazes and offices only. `aspect` is length over width, for a row of
overlapping runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from ..topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ..topology.se2 import wrap
from .chance import Chance
from .tiles import tiles_world
from .world import (
    ROOM_M,
    Link,
    World,
    polyline_heading,
    straight_world,
    without_bends,
    world_of_links,
)

LOOPS = 0.7
"""Share of the possible streets that close a loop that are built, in cities and organic worlds."""

COPIES_DIFFER = 0.02
"""Relative standard deviation of lengths that are the same in an office's floor plan."""

STREET_M = 8.0
"""Longest street of organic worlds, and most between rows of mazes."""

BOW = 0.14
"""Largest distance of a curved street from its chord, as a share of its length."""


def maze_world(junctions: int, seed: int, aspect: float = 1.0) -> World:
    """A rectilinear maze: a random spanning tree of an irregular grid, plus a quarter of the other
    links.

    Rows and columns are 2.5 to 8 m apart. About `junctions` vertices of one to four branches.
    """
    chance = Chance("maze", seed)
    x, y, walls = _lattice(junctions / 0.86, aspect, 2, (2.5, STREET_M), chance)
    xy = np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])
    opened = _growing_tree(walls, len(xy), chance) | chance.happens(0.25, len(walls))
    return straight_world(f"maze-{junctions}-{seed}", "maze", xy, walls[opened].tolist())


def _lattice(
    cells: float, aspect: float, least: int, apart_m: tuple[float, float], chance: Chance
) -> tuple[FloatArray, FloatArray, IntArray]:
    """An irregular grid of about `cells` cells, numbered row by row, with at least `least` rows and
    columns: coordinates of its columns (c,) and rows (r,) [m], and pairs (w, 2) of neighbouring
    cells."""
    columns = max(least, round(np.sqrt(cells * aspect)))
    rows = max(least, round(cells / columns))
    x, y = (
        np.concatenate([[0.0], np.cumsum(chance.uniform(*apart_m, count - 1))])
        for count in (columns, rows)
    )
    return x, y, np.concatenate(_neighbours(columns, rows))


def _neighbours(columns: int, rows: int) -> tuple[IntArray, IntArray]:
    """Pairs (w, 2) of neighbouring cells in a row, and in a column; cells are numbered row by
    row."""
    cell = np.arange(rows * columns).reshape(rows, columns)
    across = np.column_stack([cell[:, :-1].ravel(), cell[:, 1:].ravel()])
    along = np.column_stack([cell[:-1].ravel(), cell[1:].ravel()])
    return across, along


def _growing_tree(walls: IntArray, cells: int, chance: Chance) -> BoolArray:
    """Which walls to open for a spanning tree of the cells, grown mostly from the newest cell."""
    beside: list[list[tuple[int, int]]] = [[] for _ in range(cells)]
    for wall, (u, v) in enumerate(walls.tolist()):
        beside[u].append((wall, v))
        beside[v].append((wall, u))
    opened = np.zeros(len(walls), np.bool_)
    active = [chance.index(cells)]
    reached = set(active)
    while active:
        at = len(active) - 1 if chance.one_happens(0.7) else chance.index(len(active))
        new = [(wall, cell) for wall, cell in beside[active[at]] if cell not in reached]
        if not new:
            active.pop(at)
            continue
        wall, cell = new[chance.index(len(new))]
        opened[wall] = True
        reached.add(cell)
        active.append(cell)
    return opened


def office_world(junctions: int, seed: int, aspect: float = 1.0) -> World:
    """A building of wings with one floor plan, along a main corridor.

    Every wing has two corridors with evenly spaced rooms, connected half-way and at the far end;
    wings lie on both sides of the main corridor. Copies differ by 2 % in lengths (standard
    deviation) and by one door in sixteen. `aspect` has no effect.
    """
    chance = Chance("office", seed)
    rooms = 7
    plan = chance.happens(0.85, 4 * rooms).reshape(2, 2, rooms)
    plan[..., rooms // 2] = False  # where the two corridors are joined
    wings = max(1, round(junctions / (2 + 2 * rooms + plan.sum())))
    building = _Building(chance)
    last: int | None = None
    for pair in range((wings + 1) // 2):
        apart = 3 * ROOM_M * (1 + chance.one_normal(COPIES_DIFFER))
        x_main = pair * 7 * ROOM_M + np.array([0.0, apart])
        feet = []
        for x in x_main.tolist():
            last = building.vertex(x, 0.0, last)
            feet.append(last)
        for side in (1.0, -1.0)[: min(2, wings - 2 * pair)]:
            doors = plan ^ chance.happens(1 / 16, plan.size).reshape(plan.shape)
            doors[..., rooms // 2] = False
            building.add_wing(feet, x_main, side, doors)
    name = f"office-{junctions}-{seed}"
    return straight_world(name, "office", np.array(building.xy), building.links)


class _Building:
    """The vertices (x, y) [m] and the corridors of a building in the making."""

    def __init__(self, chance: Chance) -> None:
        self.chance = chance
        self.xy: list[tuple[float, float]] = []
        self.links: list[tuple[int, int]] = []

    def vertex(self, x: float, y: float, joined_to: int | None) -> int:
        """Add a vertex, with a corridor to another one; returns its number."""
        self.xy.append((x, y))
        if joined_to is not None:
            self.links.append((joined_to, len(self.xy) - 1))
        return len(self.xy) - 1

    def add_wing(self, feet: list[int], x_main: FloatArray, side: float, doors: BoolArray) -> None:
        """Add a wing: a corridor from each foot with rooms on both sides, connected twice.

        The wing on the other side is rotated by 180°, so that its corridors are swapped.
        """
        lengths = 4.2 * (1 + self.chance.normal(COPIES_DIFFER, doors.shape[2] + 1))
        along = side * np.cumsum(lengths)
        joins: list[list[int]] = []
        for corridor in (0, 1):
            foot = corridor if side > 0 else 1 - corridor
            x, here = float(x_main[foot]), feet[foot]
            joins.append([])
            for number, y in enumerate(along[:-1].tolist()):
                here = self.vertex(x, y, here)
                if number == doors.shape[2] // 2:
                    joins[-1].append(here)
                for wall, direction in enumerate((-side, side)):
                    if doors[corridor, wall, number]:
                        depth = ROOM_M * (1 + self.chance.one_normal(COPIES_DIFFER))
                        self.vertex(x + direction * depth, y, here)
            joins[-1].append(self.vertex(x, float(along[-1]), here))
        self.links.extend(zip(*joins, strict=True))


def organic_world(junctions: int, seed: int, aspect: float = 1.0) -> World:
    """Streets with irregular distances, arbitrary angles and curved corridors.

    A Gabriel graph of random points (two points are neighbours if the disc on their segment is
    empty), thinned at random and where streets would leave a junction too close together.
    """
    from scipy.spatial import Delaunay

    chance = Chance("organic", seed)
    xy = _scattered(round(junctions * 1.22) + 4, aspect, chance)
    triangles = Delaunay(xy).simplices
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    pairs = _gabriel(xy, np.unique(sides, axis=0).astype(np.int64))
    pairs = _thinned(xy, pairs, chance)
    paths = _curved(xy, pairs, chance)
    links = [(u, v, path) for (u, v), path in zip(pairs.tolist(), paths, strict=True)]
    return world_of_links(f"organic-{junctions}-{seed}", "organic", xy, without_bends(links))


def city_world(junctions: int, seed: int, aspect: float = 1.0) -> World:
    """City blocks: an irregular grid of streets, bent so that its direction changes over the city.

    Crossings are displaced by 6 % of their distances, one street in six is left out, and the plane
    is mapped by the conformal map w = z + a z², which keeps right angles but changes directions by
    about 50° and lengths by half from end to end: crossings are rectilinear, the city is not.
    """
    chance = Chance("city", seed)
    x, y, streets = _lattice(junctions / 0.9, aspect, 3, (6.0, 12.0), chance)
    z = np.tile(x - x.mean(), len(y)) + 1j * np.repeat(y - y.mean(), len(x))
    z = z + 0.5 * (chance.normal(1.0, len(z)) + 1j * chance.normal(1.0, len(z)))
    bend = 0.22 / float(np.abs(z).max()) * np.exp(1j * chance.around(np.pi, 1)[0])

    def bent(flat: ComplexArray) -> FloatArray:
        w = flat + bend * flat**2
        return np.column_stack([w.real, w.imag])

    built = _growing_tree(streets, len(z), chance) | chance.happens(LOOPS, len(streets))
    way = np.linspace(0.0, 1.0, 6)
    links: list[Link] = [
        (u, v, bent(z[u] + way * (z[v] - z[u]))) for u, v in streets[built].tolist()
    ]
    return world_of_links(f"city-{junctions}-{seed}", "city", bent(z), without_bends(links))


def rows_world(junctions: int, seed: int, aspect: float = 1.0) -> World:
    """Rows of crops or racks: aisles 3 m apart (±1 %) between two or three cross aisles.

    One aisle in 25 is blocked. Aisles differ by little more than their position by odometry.
    `aspect` has no effect.
    """
    chance = Chance("rows", seed)
    ways = 2 + int(chance.one_happens(0.5))
    aisles = max(3, round(junctions / ways))
    x = np.cumsum(ROOM_M * (1 + chance.normal(0.01, aisles)))
    y = 10 * ROOM_M * np.arange(ways)
    xy = np.column_stack([np.tile(x, ways), np.repeat(y, aisles)])
    across, along = _neighbours(aisles, ways)
    open_to_drive = ~chance.happens(1 / 25, len(along))
    pairs = np.concatenate([across, along[open_to_drive]])
    return straight_world(f"rows-{junctions}-{seed}", "rows", xy, pairs.tolist())


def _scattered(count: int, aspect: float, chance: Chance) -> FloatArray:
    """(count, 2) points in a rectangle, at least 4.8 m and about 7.5 m apart."""
    area = 50.625 * count
    size = np.array([np.sqrt(area * aspect), np.sqrt(area / aspect)])
    chosen = np.zeros((0, 2))
    # Dart throwing; the rectangle grows by 2 % where a whole batch of darts finds too little room.
    while len(chosen) < count:
        darts = chance.uniform(0.0, 1.0, 8 * count).reshape(-1, 2) * size
        for dart in darts:
            if len(chosen) == count:
                break
            if not len(chosen) or np.min(np.hypot(*(chosen - dart).T)) > 4.8:
                chosen = np.concatenate([chosen, dart[None]])
        else:
            size = size * 1.02
    return chosen


def _gabriel(xy: FloatArray, pairs: IntArray) -> IntArray:
    """The pairs whose disc of diameter u–v holds no other point."""
    from scipy.spatial import cKDTree

    middle = 0.5 * (xy[pairs[:, 0]] + xy[pairs[:, 1]])
    nearest, _ = cKDTree(xy).query(middle)
    radius = 0.5 * np.hypot(*(xy[pairs[:, 0]] - xy[pairs[:, 1]]).T)
    kept: IntArray = pairs[(nearest >= radius - 1e-9) & (radius < STREET_M)]
    return kept


def _thinned(xy: FloatArray, pairs: IntArray, chance: Chance) -> IntArray:
    """A random spanning forest of the pairs, plus further pairs where there is room.

    A street that closes a loop is built with probability 0.7 if it leaves both its junctions at 50°
    or more from every street there and neither has five streets.
    """
    reached = DisjointSet(range(len(xy)))
    step = xy[pairs[:, 1]] - xy[pairs[:, 0]]
    heading = np.arctan2(step[:, 1], step[:, 0])
    headings: list[list[float]] = [[] for _ in xy]
    wanted = chance.happens(LOOPS, len(pairs))
    order = np.argsort(np.hypot(*step.T) * (1 + chance.around(0.4, len(pairs))), kind="stable")
    tree, loops = [], []
    for i in order.tolist():
        u, v = pairs[i].tolist()
        if reached.merge(u, v):
            tree.append(i)
            headings[u].append(float(heading[i]))
            headings[v].append(float(wrap(heading[i] + np.pi)))
        else:
            loops.append(i)
    for i in loops:
        u, v = pairs[i].tolist()
        out, back = float(heading[i]), float(wrap(heading[i] + np.pi))
        roomy = len(headings[u]) < 5 and len(headings[v]) < 5
        if wanted[i] and roomy and _clear(out, headings[u], 50) and _clear(back, headings[v], 50):
            tree.append(i)
            headings[u].append(out)
            headings[v].append(back)
    built: IntArray = pairs[np.sort(tree)]
    return built


def _clear(heading: float, others: list[float], least_deg: float) -> bool:
    return all(abs(wrap(heading - other)) >= np.radians(least_deg) for other in others)


def _curved(xy: FloatArray, pairs: IntArray, chance: Chance) -> list[FloatArray]:
    """A path for every pair, bowed sideways by up to 14 % of its length where there is room."""
    from scipy.spatial import cKDTree

    t = np.linspace(0.0, 1.0, 13)
    bows = chance.around(BOW, len(pairs))
    paths = [np.array([xy[u], xy[v]]) for u, v in pairs.tolist()]
    leaving: list[dict[int, float]] = [{} for _ in xy]
    for i, (u, v) in enumerate(pairs.tolist()):
        leaving[u][i] = polyline_heading(paths[i])
        leaving[v][i] = polyline_heading(paths[i][::-1])
    fine = xy[pairs[:, :1]] + np.linspace(0, 1, 25)[None, :, None] * (
        xy[pairs[:, 1:]] - xy[pairs[:, :1]]
    )
    tree, owner = cKDTree(fine.reshape(-1, 2)), np.repeat(np.arange(len(pairs)), 25)
    for i, (u, v) in enumerate(pairs.tolist()):
        across = (xy[v] - xy[u]) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        bent = xy[u] + t[:, None] * (xy[v] - xy[u])
        bent = bent + (4 * t * (1 - t) * bows[i])[:, None] * across
        bent[[0, -1]] = xy[u], xy[v]
        out, back = polyline_heading(bent), polyline_heading(bent[::-1])
        if not (
            _clear(out, [h for k, h in leaving[u].items() if k != i], 40)
            and _clear(back, [h for k, h in leaving[v].items() if k != i], 40)
        ):
            continue
        near = tree.query_ball_point(bent[3:-3], 1.2 + BOW * STREET_M)
        if {int(owner[k]) for row in near for k in row} <= {i, *leaving[u], *leaving[v]}:
            paths[i] = bent
            leaving[u][i], leaving[v][i] = out, back
    return paths


WORLDS: Mapping[str, Callable[[int, int, float], World]] = {
    "maze": maze_world,
    "office": office_world,
    "organic": organic_world,
    "city": city_world,
    "rows": rows_world,
    "tiles": tiles_world,
}
"""Generators by kind: (junctions, seed, aspect) to a world."""


def make_world(kind: str, junctions: int, seed: int, aspect: float = 1.0) -> World:
    """A world of a kind of WORLDS."""
    return WORLDS[kind](junctions, seed, aspect)
