"""Runs with a laser, simulated inside floor plans: pairs merged, and floors that look alike.

    python benchmarks/inside.py [--maps FILE ...] [--kinds rooms,home,…] [--worlds 2] [--runs 3]
        [--way 200] [--seed 1] [--only together,…,door] [--keep DIR]
    python benchmarks/inside.py --logs FOLDER ... [--parts 2 3] [--worlds 5]

Plans are saved maps (`map.yaml`, one per building) and drawn floors: rows of `rooms`, and the kinds
of `floors.py`. In each a robot drives between random places; boxes stand anew for every run. Scans
(181 beams over half a turn, 30 m, 2 cm of noise) are `--every` metres apart; the odometry errs like
that made for `fr101`: 1 % of scale, .25°/m, .8°/√m.

  together    runs in one plan: pairs that share 20 m of way and are in one component, within 3 m;
              the rmse of the runs' places after the best rigid fit; pairs across plans
  furniture   two floors of one plan, each with furniture of its own, besides what stands anew
  bare        two floors of one plan, with what stands anew only
  mirrored    a plan and its mirror image
  door        two floors of one plan, with one corridor closed on the second

With `--logs`, folders of recorded runs as `laser.py` reads them: each is cut into parts of about
one length, `--worlds` times, at other places and with other errors of the odometry. The parts of a
cut are merged alone.

Floors that differ in furniture alone cannot be told from one floor on two days: what is merged of
them shows how far the evidence of walls carries.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from floors import CELL_M, drawn
from grids import rooms
from laser import Log, logs
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from topobatch.ingest.logs.saved_map import coarser, read_saved_map
from topobatch.ingest.mapping import build_map
from topobatch.ingest.scans.alignment import chained
from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.merge.merging import merge_maps
from topobatch.topology.arrays import BoolArray, FloatArray
from topobatch.topology.document import write_map
from topobatch.topology.odometry import Odometry
from topobatch.topology.polyline import way_of
from topobatch.topology.run import NO_DETECTIONS, Grid, Run
from topobatch.topology.se2 import apply, compose, fit_rigid, inverse
from topobatch.topology.topomap import TopoMap
from topobatch.topology.track import way_at

STEP_M, SPEED = 0.1, 0.5
REACH_M = 30.0
BEAMS = np.radians(np.arange(-90, 91))
WIDE_M = 0.2
"""Cells that ways are planned in."""
ROOM_M = 0.35
"""Clearance of the robot."""
SHARED_M, NEAR_M, RIGHT_M = 20.0, 1.5, 3.0


@dataclass(frozen=True, eq=False)
class Floor:
    """Free cells (h, w) of `cell_m`, row 0 at the smallest y."""

    name: str
    free: BoolArray
    cell_m: float

    @property
    def clear(self) -> FloatArray:
        """(h, w) distance from the nearest wall [m]."""
        return np.asarray(ndimage.distance_transform_edt(self.free) * self.cell_m)

    def furnished(self, rng: np.random.Generator, boxes: float = 0.015) -> Floor:
        """With boxes of .3 to .9 m, so many per free square metre, that leave way for the robot."""
        free = self.free.copy()
        count = rng.poisson(boxes * free.sum() * self.cell_m**2)
        there = np.argwhere(self.clear < 1.2)
        for y, x in there[rng.integers(0, len(there), count)].tolist():
            h, w = (rng.uniform(0.15, 0.45, 2) / self.cell_m).astype(int).tolist()
            free[max(y - h, 0) : y + h, max(x - w, 0) : x + w] = False
        return Floor(self.name, free, self.cell_m)

    @property
    def mirrored(self) -> Floor:
        """Its mirror image."""
        return Floor(self.name + "-mirrored", self.free[:, ::-1].copy(), self.cell_m)

    def closed(self, rng: np.random.Generator) -> Floor:
        """With a wall across one of its corridors."""
        clear = self.clear
        narrow = np.argwhere((clear > 0.45) & (clear >= ndimage.maximum_filter(clear, 3)))
        narrow = narrow[clear[tuple(narrow.T)] < 1.3]
        y, x = narrow[rng.integers(len(narrow))].tolist()
        half = round((clear[y, x] + 0.2) / self.cell_m)
        free = self.free.copy()
        free[max(y - half, 0) : y + half, max(x - half, 0) : x + half] = False
        return Floor(self.name + "-closed", free, self.cell_m)


def saved(file: Path) -> Floor:
    """A saved map, in cells of .1 m or less."""
    grid = read_saved_map(file)[0]
    return of_grid(file.stem, coarser(grid, max(int(0.1 / grid.resolution_m), 1)))


def of_grid(name: str, grid: Grid) -> Floor:
    """The free cells of a grid, without specks, of which beams would end everywhere."""
    free = grid.free & ~grid.unknown
    solid, _ = ndimage.label(~free)
    size = np.bincount(solid.ravel())
    return Floor(name, free | ((size < 4)[solid] & (solid > 0)), grid.resolution_m)


class Roads:
    """Ways in a floor: cells of WIDE_M, joined to their eight neighbours, dear near walls."""

    def __init__(self, floor: Floor) -> None:
        every = max(round(WIDE_M / floor.cell_m), 1)
        clear = floor.clear[::every, ::every]
        parts, _ = ndimage.label(clear > ROOM_M, np.ones((3, 3)))
        size = np.bincount(parts.ravel())
        size[0] = 0
        inside = parts == size.argmax()
        self.cells = np.argwhere(inside)
        self.xy = (self.cells[:, ::-1] * every + 0.5) * floor.cell_m
        number = np.full(inside.shape, -1)
        number[inside] = np.arange(len(self.cells))
        cost = 1.0 / np.minimum(clear[inside], 1.0)
        rows, columns, weight = [], [], []
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            to = self.cells + np.array([dy, dx])
            good = ((to >= 0) & (to < inside.shape)).all(axis=1)
            other = np.full(len(to), -1)
            other[good] = number[tuple(to[good].T)]
            here = np.flatnonzero(other >= 0)
            rows.append(here)
            columns.append(other[here])
            weight.append(np.hypot(dy, dx) * 0.5 * (cost[here] + cost[other[here]]))
        joined = [np.concatenate(part) for part in (rows, columns, weight)]
        n = len(self.cells)
        self.graph = coo_array((joined[2], (joined[0], joined[1])), shape=(n, n)).tocsr()

    def drive(self, way_m: float, rng: np.random.Generator) -> FloatArray:
        """(n, 2) places every STEP_M of a drive from place to place."""
        at, driven, parts = int(rng.integers(len(self.cells))), 0.0, []
        while driven < way_m:
            far, before = dijkstra(self.graph, directed=False, indices=at, return_predecessors=True)
            target = int(rng.choice(np.flatnonzero(np.isfinite(far))))
            nodes = [target]
            while nodes[-1] != at:
                nodes.append(int(before[nodes[-1]]))
            line = self.xy[nodes[::-1]]
            if len(line) < 10:
                continue
            parts.append(line[:-1])
            driven += float(way_of(line)[-1])
            at = target
        line = ndimage.gaussian_filter1d(np.concatenate(parts), 2.0, axis=0, mode="nearest")
        way = way_of(line)
        along = np.arange(0.0, min(way[-1], way_m), STEP_M)
        return np.stack([np.interp(along, way, line[:, k]) for k in (0, 1)], axis=1)


def ranges(floor: Floor, pose: FloatArray) -> FloatArray:
    """(n, m) ranges of the beams from poses (n, 3); NaN beyond REACH_M."""
    clear, cell = floor.clear, floor.cell_m
    heading = pose[:, 2, None] + BEAMS
    dx, dy = np.cos(heading), np.sin(heading)
    out = np.zeros(heading.shape)
    for _ in range(150):  # each step goes as far as the nearest wall
        x = ((pose[:, 0, None] + out * dx) / cell).astype(np.int64)
        y = ((pose[:, 1, None] + out * dy) / cell).astype(np.int64)
        inside = (x >= 0) & (y >= 0) & (x < clear.shape[1]) & (y < clear.shape[0])
        room = np.where(
            inside, clear[y.clip(0, clear.shape[0] - 1), x.clip(0, clear.shape[1] - 1)], 0
        )
        out += np.maximum(room - cell, 0.25 * cell) * (room > 0)
    return np.where(out < REACH_M, out, np.nan)


def odometry(true: Odometry, rng: np.random.Generator) -> Odometry:
    """A recording of the true drive that errs."""
    step = compose(inverse(true.pose[:-1]), true.pose[1:])
    way = np.hypot(*step[:, :2].T)
    step[:, :2] *= 1 + rng.normal(0, 0.01)
    step[:, 2] *= 1 + rng.normal(0, 0.005)
    step[:, 2] += np.radians(rng.normal(0, 0.25)) * way
    step[:, 2] += np.radians(0.8) * np.sqrt(way) * rng.normal(size=len(way))
    pose = np.concatenate([np.zeros((1, 3)), chained(np.zeros(3), step)])
    return Odometry(true.time_ns, pose, np.zeros(0, np.int64))


@dataclass(frozen=True, eq=False)
class Driven:
    """A run's map, and the truth: the floor, and where the robot was."""

    floor: str
    topomap: TopoMap
    true: Odometry

    @property
    def places(self) -> tuple[FloatArray, FloatArray]:
        """(n, 2) places of the views by the map, and truly."""
        views = self.topomap.views
        return views.pose[:, :2], self.true.at(views.time_ns)[:, :2]


def run_in(floor: Floor, way_m: float, every_m: float, seed: int, name: str) -> Driven:
    """A run inside a floor, with furniture of its own."""
    rng = np.random.default_rng(seed)
    here = floor.furnished(rng)
    line = Roads(here).drive(way_m, rng)
    ahead = np.gradient(ndimage.gaussian_filter1d(line, 3.0, axis=0, mode="nearest"), axis=0)
    pose = np.column_stack([line, np.arctan2(ahead[:, 1], ahead[:, 0])])
    time_ns = (10**9 * (1 + np.arange(len(pose)) * STEP_M / SPEED)).astype(np.int64)
    true = Odometry(time_ns, pose, np.zeros(0, np.int64))
    rows = slice(0, None, max(round(every_m / STEP_M), 1))
    seen = ranges(here, pose[rows]) + rng.normal(0, 0.02, (len(pose[rows]), len(BEAMS)))
    batch = ScanBatch(time_ns[rows], seen.astype(np.float32), REACH_M, BEAMS)
    return Driven(floor.name, map_of(name, batch, true, rng), true)


def map_of(name: str, batch: ScanBatch, true: Odometry, rng: np.random.Generator) -> TopoMap:
    """The map of a run by its scans, with an odometry that errs."""
    found = detect(odometry(true, rng), [batch], may_lag=False)
    return build_map(Run(name, found.odometry, NO_DETECTIONS, scanned=found.scanned))


def parts_of(log: Log, count: int, every_m: float, seed: int) -> list[Driven]:
    """A recorded run cut into so many, by its corrected path, each with an odometry that errs."""
    rng = np.random.default_rng([seed, count])
    first = log.scans[0]
    time_ns = np.concatenate([batch.times_ns for batch in log.scans])
    seen = np.concatenate([batch.ranges_m for batch in log.scans])
    inside = (time_ns >= log.truth.time_ns[0]) & (time_ns <= log.truth.time_ns[-1])
    time_ns, rows = np.unique(time_ns[inside], return_index=True)
    seen, way = seen[inside][rows], way_at(log.truth, time_ns)
    cuts = way[-1] * (np.arange(1, count) + rng.uniform(-0.15, 0.15, count - 1)) / count
    runs = []
    for begin, end in pairwise([0.0, *cuts, np.inf]):
        part = np.flatnonzero((way >= begin) & (way < end))
        part = part[np.unique((way[part] / every_m).astype(np.int64), return_index=True)[1]]
        true = Odometry(time_ns[part], log.truth.at(time_ns[part]), np.zeros(0, np.int64))
        batch = ScanBatch(true.time_ns, seen[part], float(np.max(first.free_m)), first.angles_rad)
        topomap = map_of(f"{log.name}-{len(runs)}", batch, true, rng)
        along = np.arange(way[part[0]], way[part[-1]], STEP_M)
        dense_ns = np.interp(along, way[part], true.time_ns).astype(np.int64)
        dense = Odometry(dense_ns, log.truth.at(dense_ns), np.zeros(0, np.int64))
        runs.append(Driven(log.name, topomap, dense))
    return runs


def shared_m(a: Driven, b: Driven) -> float:
    """Way of b that a drove, too [m]."""
    near, _ = cKDTree(a.true.pose[:, :2]).query(b.true.pose[:, :2])
    return float((near < NEAR_M).sum() * STEP_M)


def off_m(T_a_b: FloatArray, a: Driven, b: Driven) -> float:
    """Median distance of b's places, as a component has them, from the true ones [m]."""
    shown, true = (fit_rigid(*run.places) for run in (a, b))
    T_true = compose(shown, inverse(true))
    at = b.places[0]
    return float(np.median(np.hypot(*(apply(T_a_b, at) - apply(T_true, at)).T)))


def judge(runs: list[Driven]) -> Counter[str]:
    """Counts of pairs, after one merge of all runs."""
    result = merge_maps([run.topomap for run in runs])
    placed = {name: (k, T) for k, c in enumerate(result.components) for name, T in c.poses.items()}
    verdict = {frozenset((v.a, v.b)): v for v in result.verdicts}
    out: Counter[str] = Counter()
    for a, b in combinations(runs, 2):
        (one, T_a), (two, T_b) = placed[a.topomap.run], placed[b.topomap.run]
        told = verdict[frozenset((a.topomap.run, b.topomap.run))]
        if a.floor != b.floor:
            out["strange"] += 1
            out["false"] += one == two
            out["open"] += one != two and str(told.verdict) == "ambiguous"
            continue
        good = one == two and off_m(compose(inverse(T_a), T_b), a, b) < RIGHT_M
        out["wrong"] += one == two and not good
        if shared_m(a, b) >= SHARED_M:
            out["pairs"] += 1
            out["right"] += good
    return out


def rmse_m(run: Driven) -> float:
    """Of a run's places after the best rigid fit."""
    shown, true = run.places
    off = true - apply(fit_rigid(true, shown), shown)
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def in_parts(options: argparse.Namespace) -> None:
    """Print counts for recorded runs cut into parts."""
    for log in (log for folder in options.logs for log in logs(folder)):
        for count in options.parts:
            cuts = (parts_of(log, count, options.every, seed) for seed in range(options.worlds))
            total = sum(map(judge, cuts), Counter[str]())
            print(f"{log.name} in {count}: {dict(total)}", flush=True)


def floors(options: argparse.Namespace) -> list[Floor]:
    """The plans."""
    plain = options.worlds if "rooms" in options.kinds else 0
    found = [of_grid(f"floor-{k}", rooms(options.seed + k, 0.1)) for k in range(plain)]
    more = drawn(options.kinds, options.worlds, options.seed)
    found += [Floor(name, free, CELL_M) for name, free in more]
    return [*found, *map(saved, options.maps)]


def alike(kind: str, plan: Floor, rng: np.random.Generator) -> list[Floor]:
    """Two floors that look alike."""
    other = Floor(plan.name + "-other", plan.free, plan.cell_m)
    if kind == "mirrored":
        return [plan, plan.mirrored]
    if kind == "door":
        return [plan, other.closed(rng)]
    if kind == "furniture":
        return [floor.furnished(rng, 0.05) for floor in (plan, other)]
    return [plan, other]


KINDS = ("together", "furniture", "bare", "mirrored", "door")


def main() -> None:
    """Print counts for every plan."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    command.add_argument("--maps", type=Path, nargs="*", default=[])
    command.add_argument("--logs", type=Path, nargs="*", default=[])
    command.add_argument("--parts", type=int, nargs="*", default=[2, 3])
    command.add_argument("--kinds", type=lambda text: text.split(","), default=["rooms"])
    command.add_argument("--worlds", type=int, default=2, help="drawn floors of a kind")
    command.add_argument("--runs", type=int, default=3, help="per floor")
    command.add_argument("--way", type=float, default=200.0, help="of each run [m]")
    command.add_argument("--every", type=float, default=1.0, help="metres from scan to scan")
    command.add_argument("--seed", type=int, default=1)
    command.add_argument("--only", type=lambda text: text.split(","), default=list(KINDS))
    command.add_argument("--keep", type=Path, help="folder for the maps")
    options = command.parse_args()
    if options.logs:
        return in_parts(options)
    plans = floors(options)
    rng = np.random.default_rng(options.seed)
    for kind in options.only:
        batches = [(plan.name, [plan]) for plan in plans]
        if kind != "together":
            batches = [(plan.name, alike(kind, plan, rng)) for plan in plans]
        total: Counter[str] = Counter()
        everything: list[Driven] = []
        for name, several in batches:
            seeds = rng.integers(1 << 30, size=len(several) * options.runs).tolist()
            runs = [
                run_in(floor, options.way, options.every, seed, f"{kind}-{name}-{k}")
                for k, (floor, seed) in enumerate(
                    zip([f for f in several for _ in range(options.runs)], seeds, strict=True)
                )
            ]
            found = judge(runs)
            errors = ", ".join(f"{rmse_m(run):.2f}" for run in runs)
            print(f"{kind} {name}: {dict(found)}; rmse {errors}", flush=True)
            total += found
            everything += runs
            for run in runs if options.keep else ():
                write_map(options.keep / "maps" / f"{run.topomap.run}.json", run.topomap)
        if kind == "together":
            print(f"{kind}, one batch of all: {dict(judge(everything))}")
        print(f"{kind}: {dict(total)}", flush=True)


if __name__ == "__main__":
    main()
