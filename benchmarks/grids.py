"""Saved grids: junctions that come back, corridors that can be driven, time of a map.

    python benchmarks/grids.py [--maps DIR ...] [--only again,…,merged] [--worlds 1]

Maps are plans of simulated worlds, drawn in cells of 0.04 m, and the saved maps in the folders DIR
(`*.yaml` and their pictures; `truth.json` beside them holds the placements of pairs).

  again       the same map changed: turned (resampled without interpolation), in coarser cells (a
              cell is occupied if any part is), with speckle (1 % of the free cells occupied, 1 %
              unknown, 1 % of the occupied cells free), with walls a cell thicker. The share of
              junctions of either that the other has within 0.3 m, and how many junctions it has
  recordings  two maps of one place under the true placement: the share of junctions of either that
              the other has within 0.3, 0.6 and 1 m; and of those that both maps know well: their
              confidence is 5 of 7 or more, and the other map knows 95 % of the cells that this one
              shows free within 2.5 m, and 95 % of those it holds free too
  ways        metres of corridor: in occupied cells, in unknown cells, nearer to either than the
              radius of the robot; median clearance; lengths stated over lengths of paths; share of
              the reachable free space within 1 m of the discs along ways; of simulated worlds the
              share of junctions found within 0.5 m, and the median error of their corridors' length
  merged      a map and the same changed, two a batch: turned, cropped to 70 and 50 % of its length,
              turned with furniture (25 boxes of .3 to .9 m) and speckle, turned in cells twice as
              large. Merged and right (within 1 m), merged wrongly, open
  time        seconds of one core for plans of 1,000 m² of free space, and the largest map of each
              group
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage
from scipy.spatial import cKDTree

from topobatch.ingest.grid_map import map_of_grid
from topobatch.ingest.logs.grids import GridLog
from topobatch.ingest.logs.saved_map import read_saved_map
from topobatch.merge.merging import merge_maps
from topobatch.simulation.walls import free_space
from topobatch.simulation.world import World
from topobatch.simulation.worlds import make_world
from topobatch.topology.arrays import BoolArray, FloatArray
from topobatch.topology.errors import TopobatchError
from topobatch.topology.run import Grid
from topobatch.topology.se2 import apply, compose, inverse
from topobatch.topology.topomap import TopoMap

KINDS = ("maze", "office", "organic", "city")
TURNS_DEG = (7, 30, 37, 45, 61, 90)
ROBOT_M = 0.25
WELL = 5 / 7 - 1e-9
AROUND_M = 2.5


class Plan(NamedTuple):
    """A grid by name; world: that it was drawn from."""

    name: str
    grid: Grid
    world: World | None = None


def drawn(world: World, cell_m: float, corridor_m: float = 1.4) -> Grid:
    """The free space of a world, with walls of 0.15 m."""
    polygons = free_space(world, corridor_m)
    low = np.min([p.min(axis=0) for p in polygons], axis=0) - 1
    high = np.max([p.max(axis=0) for p in polygons], axis=0) + 1
    width, height = np.ceil((high - low) / cell_m).astype(int).tolist()
    picture = Image.new("L", (width, height), 0)
    pen = ImageDraw.Draw(picture)
    for polygon in polygons:
        pen.polygon([tuple(p) for p in (polygon - low) / cell_m], fill=1)
    free = np.asarray(picture) > 0
    walls = ndimage.binary_dilation(free, iterations=max(1, round(0.15 / cell_m))) & ~free
    return Grid(free, ~free & ~walls, cell_m, (float(low[0]), float(low[1]), 0.0))


def rooms(seed: int, cell_m: float, size_m: tuple[float, float] = (32.0, 18.0)) -> Grid:
    """A floor: rows of rooms along two corridors that a third one joins, doors of 0.9 m, some of
    them between rooms, and furniture in every second room."""
    rng = np.random.default_rng(seed)
    width, depth = size_m
    h, w = (round(n / cell_m) + 40 for n in (depth, width))
    free = np.zeros((h, w), bool)

    def clear(x: float, y: float, to_x: float, to_y: float, value: bool = True) -> None:
        a, b, c, d = (20 + round(n / cell_m) for n in (x, y, to_x, to_y))
        free[b:d, a:c] = value

    wall, door, hall = 0.15, 0.9, rng.uniform(1.6, 2.4, 3)
    low, high = 0.27 * depth, 0.73 * depth
    bands = [
        (0.0, low - hall[0] / 2, low - hall[0] / 2),
        (low + hall[0] / 2, (low + high) / 2, low + hall[0] / 2),
        ((low + high) / 2, high - hall[1] / 2, high - hall[1] / 2),
        (high + hall[1] / 2, depth, high + hall[1] / 2),
    ]
    for y, span in ((low, hall[0]), (high, hall[1])):
        clear(0, y - span / 2 + wall / 2, width, y + span / 2 - wall / 2)
    middle = rng.uniform(0.35, 0.65) * width
    for band, (bottom, top, beside) in enumerate(bands):
        x = 0.0
        while x < width - 1.5:
            to = min(x + rng.uniform(2.8, 6.5), width)
            to = width if width - to < 2.5 else to
            if band in (1, 2) and x < middle < to and to - x > hall[2] + 1:
                to = x + max(2.0, middle - x)
            clear(x + wall / 2, bottom + wall / 2, to - wall / 2, top - wall / 2)
            at = rng.uniform(x + 0.3, to - 0.3 - door)
            clear(at, beside - wall, at + door, beside + wall)
            if rng.random() < 0.2 and to < width:
                at = rng.uniform(bottom + 0.3, top - 0.3 - door)
                clear(to - wall, at, to + wall, at + door)
            for _ in range(rng.integers(0, 4) if rng.random() < 0.5 else 0):
                a, b = rng.uniform(x + 0.3, to - 1.5), rng.uniform(bottom + 0.3, top - 1.5)
                clear(a, b, a + rng.uniform(0.1, 1.2), b + rng.uniform(0.1, 0.8), value=False)
            x = to
    clear(middle - hall[2] / 2, low, middle + hall[2] / 2, high)
    walls = ndimage.binary_dilation(free, iterations=max(1, round(0.15 / cell_m))) & ~free
    return Grid(free, ~free & ~walls, cell_m, (0.0, 0.0, 0.0))


def pillars(cell_m: float = 0.05) -> Grid:
    """A hexagonal room with nine round pillars, as in the first map of many tutorials."""
    y, x = np.mgrid[-3 : 3 : 1j * round(6 / cell_m), -3 : 3 : 1j * round(6 / cell_m)]
    turns = np.radians([0, 60, 120])
    free = np.max([np.abs(x * np.cos(t) + y * np.sin(t)) for t in turns], axis=0) < 2.4
    inside = ndimage.binary_dilation(free, iterations=4)
    for a in (-1.1, 0.0, 1.1):
        for b in (-1.1, 0.0, 1.1):
            free &= np.hypot(x - a, y - b) > 0.15
    return Grid(free, ~inside, cell_m, (-3.0, -3.0, 0.0))


def plans(count: int, cell_m: float = 0.04) -> Iterator[Plan]:
    for seed in range(7100, 7100 + 3 * count):
        yield Plan(f"rooms-{seed}", rooms(seed, cell_m))
    yield Plan("pillars-0", pillars())
    for kind in KINDS:
        for seed in range(7100, 7100 + count):
            world = make_world(kind, 40, seed)
            yield Plan(f"{kind}-{seed}", drawn(world, cell_m), world)


def saved(folder: Path) -> Iterator[Plan]:
    for file in sorted(folder.glob("*.yaml")):
        try:
            yield Plan(file.stem, read_saved_map(file)[0])
        except TopobatchError as error:
            print(f"{file.name}: {error}")


def topomap(plan: Plan) -> TopoMap | None:
    try:
        return map_of_grid(GridLog(plan.name, plan.grid, {}))
    except TopobatchError as error:
        print(f"{plan.name}: no map: {str(error)[:100]}")
        return None


# --- changes -----------------------------------------------------------------------------------


def centres(grid: Grid) -> FloatArray:
    """(h, w, 2) centres of cells in the map's frame."""
    rows, columns = np.indices(grid.free.shape)
    cells = np.stack([columns + 0.5, rows + 0.5], axis=-1) * grid.resolution_m
    return apply(np.array(grid.origin), cells.reshape(-1, 2)).reshape(*grid.free.shape, 2)


def looked_up(grid: Grid, xy: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Whether the cells at points (..., 2) of the map's frame are free, and unknown."""
    flat = apply(inverse(np.array(grid.origin)), xy.reshape(-1, 2)) / grid.resolution_m
    column, row = np.floor(flat).astype(np.int64).T
    h, w = grid.free.shape
    inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
    free, unknown = np.zeros(len(flat), bool), np.ones(len(flat), bool)
    free[inside] = grid.free[row[inside], column[inside]]
    unknown[inside] = grid.unknown[row[inside], column[inside]]
    return free.reshape(xy.shape[:-1]), unknown.reshape(xy.shape[:-1])


def turned(grid: Grid, degrees: float) -> Grid:
    """The grid in cells turned by an angle; the map's frame stays."""
    h, w = grid.free.shape
    corners = np.array([(0, 0), (w, 0), (0, h), (w, h)]) * grid.resolution_m
    yaw = grid.origin[2] + np.radians(degrees)
    turn = np.array([0.0, 0.0, yaw])
    box = apply(inverse(turn), apply(np.array(grid.origin), corners))
    x, y, _ = compose(turn, np.array([*box.min(axis=0), 0.0])).tolist()
    columns, rows = np.ceil(np.ptp(box, axis=0) / grid.resolution_m).astype(int).tolist()
    none = np.zeros((rows, columns), bool)
    lattice = Grid(none, none, grid.resolution_m, (x, y, float(yaw)))
    free, unknown = looked_up(grid, centres(lattice))
    return lattice._replace(free=free, unknown=unknown)


def coarser(grid: Grid, factor: int) -> Grid:
    """Blocks of cells as one: occupied if any is, else free if any is."""
    h, w = (factor * (n // factor) for n in grid.free.shape)
    occupied = ~grid.free & ~grid.unknown

    def any_of(cells: BoolArray) -> BoolArray:
        blocks = cells[:h, :w].reshape(h // factor, factor, w // factor, factor)
        return np.asarray(blocks.any(axis=(1, 3)))

    wall = any_of(occupied)
    free = any_of(grid.free) & ~wall
    return grid._replace(free=free, unknown=~free & ~wall, resolution_m=factor * grid.resolution_m)


def speckled(grid: Grid) -> Grid:
    chance = np.random.default_rng(5).random(grid.free.shape)
    occupied = ~grid.free & ~grid.unknown
    free = grid.free & (chance >= 0.02) | occupied & (chance >= 0.99)
    unknown = grid.unknown | grid.free & (chance < 0.01)
    return grid._replace(free=free, unknown=unknown)


def thicker(grid: Grid) -> Grid:
    occupied = ~grid.free & ~grid.unknown
    return grid._replace(free=grid.free & ~ndimage.binary_dilation(occupied))


def cropped(grid: Grid, share: float) -> Grid:
    """A share of what is known of a grid, along its longer side."""
    rows, columns = (np.flatnonzero(~grid.unknown.all(axis=axis)) for axis in (1, 0))
    known = np.ones(grid.free.shape, bool)
    if np.ptp(columns) >= np.ptp(rows):
        known[:, columns[0] + int(share * np.ptp(columns)) :] = False
    else:
        known[rows[0] + int(share * np.ptp(rows)) :] = False
    return grid._replace(free=grid.free & known, unknown=grid.unknown | ~known)


def furnished(grid: Grid) -> Grid:
    rng, free = np.random.default_rng(3), grid.free.copy()
    rows, columns = np.nonzero(grid.free)
    for k in rng.integers(0, len(rows), 25).tolist():
        half = int(rng.uniform(0.3, 0.9) / grid.resolution_m / 2) + 1
        y, x = rows[k], columns[k]
        free[max(y - half, 0) : y + half, max(x - half, 0) : x + half] = False
    return grid._replace(free=free)


MERGED: dict[str, Callable[[Grid], Grid]] = {
    "30 deg": lambda g: turned(g, 30),
    "70 %, 37 deg": lambda g: turned(cropped(g, 0.7), 37),
    "50 %, 30 deg": lambda g: turned(cropped(g, 0.5), 30),
    "furniture, 37": lambda g: turned(speckled(furnished(g)), 37),
    "2x, 103 deg": lambda g: coarser(turned(g, 103), 2),
}

CHANGES: dict[str, Callable[[Grid], Grid]] = {
    **{f"{d} deg": partial(turned, degrees=d) for d in TURNS_DEG},
    "2x cells": lambda g: coarser(g, 2),
    "30, 2x": lambda g: coarser(turned(g, 30), 2),
    "speckle": speckled,
    "thicker": thicker,
}


# --- tables ------------------------------------------------------------------------------------


def junctions(found: TopoMap | None) -> FloatArray:
    if found is None:
        return np.zeros((0, 2))
    return found.xy[[kind == "junction" for kind in found.kind]]


def back(a: FloatArray, b: FloatArray, within_m: float) -> tuple[int, int]:
    """Points of either that the other has within a distance, and points of both."""
    if not len(a) or not len(b):
        return 0, len(a) + len(b)
    hits = 0
    for p, q in ((a, b), (b, a)):
        hits += int((cKDTree(q).query(p)[0] <= within_m).sum())
    return hits, len(a) + len(b)


def again(groups: dict[str, list[Plan]]) -> None:
    print(f"\nagain{'':13} {'junctions':>9} " + " ".join(f"{name:>11}" for name in CHANGES))
    for group, members in groups.items():
        sums = {name: np.zeros(3, int) for name in CHANGES}
        own = 0
        for plan in members:
            first = junctions(topomap(plan))
            own += len(first)
            for name, change in CHANGES.items():
                second = junctions(topomap(plan._replace(grid=change(plan.grid))))
                sums[name] += (*back(first, second, 0.3), len(second))
        cells = [f"{a / max(n, 1):6.3f} {count:4}" for a, n, count in sums.values()]
        print(f"{group:18} {own:9} " + " ".join(cells), flush=True)
        turns = sum((sums[f"{d} deg"] for d in TURNS_DEG), np.zeros(3, int))
        print(f"{'':18} all turns {turns[0] / max(turns[1], 1):.3f}", flush=True)


def merged(groups: dict[str, list[Plan]]) -> None:
    """The frame of a changed map is that of the map: the true placement moves nothing."""
    print(f"\nmerged{'':12} maps " + " ".join(f"{name:>14}" for name in MERGED))
    for group, members in groups.items():
        counts = {name: np.zeros(3, int) for name in MERGED}
        for plan in members:
            for name, change in MERGED.items():
                other = Plan(f"{plan.name}-changed", change(plan.grid))
                both = [found for p in (plan, other) if (found := topomap(p)) is not None]
                (pair,) = merge_maps(both).verdicts if len(both) == 2 else (None,)
                if pair is None or not pair.accepted or pair.best is None:
                    counts[name][2] += 1
                    continue
                off = apply(pair.best.transform, both[1].xy) - both[1].xy
                counts[name][int(np.hypot(*off.T).max() > 1.0)] += 1
        cells = (f"{a:>6} {b:>3} {c:>3}" for a, b, c in counts.values())
        print(f"{group:18} {len(members):4} " + " ".join(cells))


def known_well(found: TopoMap, own: Grid, other: Grid, placement: FloatArray) -> BoolArray:
    """(j,) junctions of a map that both maps know well. placement: this frame in the other's."""
    there = np.array([kind == "junction" for kind in found.kind])
    xy, out = found.xy[there], found.confidence[there] >= WELL
    step = np.arange(-AROUND_M, AROUND_M + 0.05, 0.1)
    disc = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) <= AROUND_M]
    for k, at in enumerate(xy):
        shown, _ = looked_up(own, disc + at)
        free, unknown = looked_up(other, apply(placement, (disc + at)[shown]))
        out[k] &= (~unknown).mean() >= 0.95 and free.mean() >= 0.95
    return out


def recordings(folder: Path, members: list[Plan]) -> None:
    truth = json.loads((folder / "truth.json").read_text())
    maps = {plan.name: topomap(plan) for plan in members}
    grids = {plan.name: plan.grid for plan in members}
    rows: dict[str, np.ndarray] = {}
    for a, b in combinations(sorted(maps), 2):
        pair, one, other = truth["pairs"].get(f"{a}|{b}"), maps[a], maps[b]
        if pair is None or one is None or other is None:
            continue
        b_in_a = np.array([pair["x"], pair["y"], pair["theta"]])
        sides = ((one, other, grids[a], grids[b], inverse(b_in_a)),)
        sides += ((other, one, grids[b], grids[a], b_in_a),)
        row = rows.setdefault(truth["places"][a], np.zeros(10))
        row[0] += 1
        for this, that, own, others, placement in sides:
            xy = apply(placement, junctions(this))
            if not len(xy):
                continue
            free, _ = looked_up(others, xy)
            away = np.full(len(xy), np.inf)
            if len(junctions(that)):
                away, _ = cKDTree(junctions(that)).query(xy)
            well = known_well(this, own, others, placement)
            for k, some in ((1, free), (5, well)):
                row[k] += some.sum()
                row[k + 1 : k + 4] += [(away[some] <= m).sum() for m in (0.3, 0.6, 1.0)]
        row[9] += min(len(junctions(one)), len(junctions(other)))
    for place, row in rows.items():
        free, well = (
            " / ".join(f"{n / max(row[k], 1):.2f}" for n in row[k + 1 : k + 4]) for k in (1, 5)
        )
        print(
            f"{place}: {row[0]:.0f} pairs, {row[9] / row[0]:.1f} junctions of the smaller; within "
            f".3 / .6 / 1 m: {free} of {row[1]:.0f} in free space of the other; {well} of "
            f"{row[5]:.0f} that both know well",
            flush=True,
        )


def dense(path: FloatArray, step: float) -> FloatArray:
    """(k, 2) points along a polyline, at most `step` apart."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    at = np.linspace(0, way[-1], max(2, int(way[-1] / step) + 2))
    return np.stack([np.interp(at, way, path[:, k]) for k in (0, 1)], axis=-1)


def ways_of(found: TopoMap) -> list[FloatArray]:
    return [*found.paths, *found.turning_points.paths]


def ways(groups: dict[str, list[Plan]]) -> None:
    print(
        f"\n{'ways':18} {'metres':>8} {'occupied':>8} {'unknown':>8} {'near':>8} {'clear m':>8} "
        f"{'stated':>7} {'covered':>7} {'found':>6} {'length m':>8}"
    )
    for group, members in groups.items():
        sums, clear, stated, covered, there, off = np.zeros(4), [], [], np.zeros(2), [], []
        for plan in members:
            found = topomap(plan)
            if found is None:
                continue
            grid, cell = plan.grid, plan.grid.resolution_m
            gap = ndimage.distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1] * cell
            points = np.concatenate([dense(path, 0.02) for path in ways_of(found)])
            free, unknown = looked_up(grid, points)
            at = np.floor(apply(inverse(np.array(grid.origin)), points) / cell).astype(np.int64)
            at = np.clip(at, 0, np.array(grid.free.shape[::-1]) - 1)
            room = gap[at[:, 1], at[:, 0]]
            total = sum(np.hypot(*np.diff(path, axis=0).T).sum() for path in ways_of(found))
            each = total / len(points)
            # Distances are those of centres of cells.
            sums += (
                *(total, each * (~free & ~unknown).sum(), each * unknown.sum()),
                each * (room < ROBOT_M - cell).sum(),
            )
            clear.append(room)
            stated += [
                length / np.hypot(*np.diff(path, axis=0).T).sum()
                for length, path in zip(found.length, found.paths, strict=True)
            ]
            covered += coverage(grid, gap, at, room)
            if plan.world is not None:
                true = plan.world.xy[plan.world.branches.counts >= 3]
                there += (cKDTree(junctions(found)).query(true)[0] <= 0.5).tolist()
                off += lengths_off(plan.world, found)
        if not clear:
            continue
        print(
            f"{group:18} {sums[0]:8.0f} "
            + " ".join(f"{n:8.1f}" for n in sums[1:])
            + f" {np.median(np.concatenate(clear)):8.2f} {np.median(stated):7.3f}"
            + f" {covered[0] / covered[1]:7.3f}"
            + (f" {np.mean(there):6.3f} {np.median(off):8.3f}" if there else ""),
            flush=True,
        )


def coverage(grid: Grid, gap: FloatArray, at: np.ndarray, room: FloatArray) -> FloatArray:
    """Cells that a robot can reach from the ways and is within 1 m of a disc along them; all that
    it can reach."""
    parts, _ = ndimage.label(gap > ROBOT_M, np.ones((3, 3)))
    own = np.unique(parts[at[:, 1], at[:, 0]])
    reach = np.isin(parts, own[own > 0])
    size = np.bincount(parts.ravel())
    size[0] = 0
    # Where the ways hold to the largest part they should.
    if size.max() > reach.sum():
        reach |= parts == int(size.argmax())
    seeds = np.zeros(reach.shape, bool)
    seeds[at[:, 1], at[:, 0]] = True
    wide = np.zeros(reach.shape)
    np.maximum.at(wide, (at[:, 1], at[:, 0]), room)
    away, nearest = ndimage.distance_transform_edt(~seeds, return_indices=True)
    disc = wide[nearest[0], nearest[1]]
    near = away * grid.resolution_m <= disc + 1.0
    return np.array([(reach & near).sum(), reach.sum()], float)


def lengths_off(world: World, found: TopoMap) -> list[float]:
    """Errors [m] of the corridors between junctions that a map has of a world."""
    away, near = cKDTree(world.xy).query(found.xy)
    of = np.where(away <= 0.5, near, -1)
    true: dict[frozenset[int], list[float]] = {}
    for a, b, length in zip(
        world.source.tolist(), world.target.tolist(), world.length, strict=True
    ):
        true.setdefault(frozenset((a, b)), []).append(float(length))
    out = []
    for u, v, length in zip(found.source, found.target, found.length, strict=True):
        ends = frozenset((int(of[u]), int(of[v])))
        if found.kind[u] == found.kind[v] == "junction" and ends in true:
            out.append(min(abs(length - other) for other in true[ends]))
    return out


def seconds(groups: dict[str, list[Plan]]) -> None:
    print(f"\n{'time':18} {'cells':>12} {'free m²':>8} {'s':>6}")
    world = make_world("office", 160, 7100)
    for cell in (0.1, 0.05, 0.02):
        timed(Plan(f"rooms {cell:g} m", rooms(7100, cell, (46.0, 24.0))))
        timed(Plan(f"office {cell:g} m", drawn(world, cell)))
    for members in groups.values():
        slow = max(members, key=lambda plan: int(plan.grid.free.sum()))
        timed(slow)


def timed(plan: Plan) -> None:
    took = []
    for _ in range(2):
        begin = time.process_time()
        topomap(plan)
        took.append(time.process_time() - begin)
    h, w = plan.grid.free.shape
    area = plan.grid.free.sum() * plan.grid.resolution_m**2
    print(f"{plan.name:18} {f'{w} x {h}':>12} {area:8.0f} {min(took):6.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--maps", type=Path, action="append", default=[])
    parser.add_argument("--only", default="again,recordings,ways,time")
    parser.add_argument("--worlds", type=int, default=1)
    args = parser.parse_args()
    only = args.only.split(",")
    groups: dict[str, list[Plan]] = {}
    for plan in plans(args.worlds):
        groups.setdefault(plan.name.split("-")[0], []).append(plan)
    folders = {folder: list(saved(folder)) for folder in args.maps}
    for folder, members in folders.items():
        groups[folder.name] = members
    if "recordings" in only:
        for folder, members in folders.items():
            if (folder / "truth.json").is_file():
                recordings(folder, members)
    if "ways" in only:
        ways(groups)
    if "time" in only:
        seconds(groups)
    if "again" in only:
        again(groups)
    if "merged" in only:
        merged(groups)


if __name__ == "__main__":
    main()
