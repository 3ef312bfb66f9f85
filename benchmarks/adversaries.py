"""False merges in adversarial worlds.

    python benchmarks/adversaries.py [--seeds N] [--first S] [--only NAME ...] [--without RULE]

Every adversary makes a batch of maps of several runs, in worlds with repeated parts or with parts
of one another, none of which were used to tune anything, or of runs with gross errors. Each batch
is merged as a whole, and two runs at a time.

Wrong: pairs merged at a false placement, or of two worlds; at most: upper end of Wilson's 95 %
interval of their share; promised: number that the false-merge rate allows. Right: pairs with at
least FEWEST common junctions, and a quarter of the smaller map, that end in one component. Twice,
mixed: junctions with several vertices in a component of the fused map, and fused vertices of
several junctions. Floors that differ by a door, and worlds with rotational symmetry, cannot be told
apart by a run that saw only one of the alternatives.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from aliasing import FEWEST, RULES, leave_out
from observed import Seeing, observed_map, scattered_maps
from plans import doors, lattice, modular, moved, spiral, star, symmetric, with_block, without_some

from topobatch.merge.merging import merge_maps
from topobatch.merge.robust import DEFAULT_ROBUST
from topobatch.merge.robust.mirror import mirrored
from topobatch.simulation.regions import grown
from topobatch.simulation.worlds import make_world
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import wrap
from topobatch.topology.topomap import TopoMap

RUNS, SIZE = 3, 32
"""Runs of each world, and junctions that each saw."""
SEEING = Seeing(missed=0.03, branch_fault=0.04, bend_m=0.3)
HARSH = Seeing(centre_m=0.1, branch_rad=0.09, missed=0.08, branch_fault=0.12, bend_m=0.4)
BENT = replace(SEEING, bend_m=1.5)


def runs_of(worlds, seed, seeing=SEEING, runs=RUNS, size=SIZE):
    """Maps of runs scattered over each world."""
    return [
        of_world(m, w)
        for w, world in enumerate(worlds)
        for m, _ in scattered_maps(world, runs, min(size, len(world)), 100 * seed + w, seeing)
    ]


def of_world(m, world):
    """A map that tells of which world it is."""
    return replace(
        m, run=f"w{world}-{m.run}", info={"world": world, "truth": list(m.info["truth"])}
    )


def longer(m, factor):
    """A map all of whose lengths are larger."""
    return replace(
        m,
        xy=m.xy * factor,
        length=m.length * factor,
        paths=tuple(path * factor for path in m.paths),
    )


def with_phantoms(m, share, rng):
    """A map that shows junctions where there are none: in the middle of such a share of its
    corridors."""
    long = np.flatnonzero(m.length > 3.0)
    some = set(long[rng.random(len(long)) < share].tolist())
    n = len(m)
    xy, rows, kind = [*m.xy], [m.branches[v] for v in range(n)], [*m.kind]
    parts, truth = [], list(m.info["truth"])
    for e, path in enumerate(m.paths):
        u, v = int(m.source[e]), int(m.target[e])
        leave, arrive = int(m.source_branch[e]), int(m.target_branch[e])
        sigma, times = m.length_sigma[e], int(m.traversals[e])
        if e not in some:
            parts.append((u, v, leave, arrive, m.length[e], sigma, times, path))
            continue
        middle = path[[0, -1]].mean(axis=0)
        new = len(xy)
        out = [np.arctan2(*(end - middle)[::-1]) for end in (xy[u], xy[v])]
        row = np.sort(wrap(np.array([*out, out[0] + rng.uniform(0.7, 2.4)])))
        xy.append(middle)
        rows.append(row)
        kind.append("junction")
        truth.append(-1 - e)
        first, second = (int(np.abs(wrap(row - o)).argmin()) for o in out)
        halves = np.array([path[0], middle]), np.array([middle, path[-1]])
        parts.append((u, new, leave, first, m.length[e] / 2, sigma, times, halves[0]))
        parts.append((new, v, second, arrive, m.length[e] / 2, sigma, times, halves[1]))
    source, target, leave, arrive, length, sigma, times, paths = zip(*parts, strict=True)
    seen = np.concatenate([m.observation_vertex, np.arange(n, len(xy))])
    return TopoMap(
        run=m.run,
        frame=m.frame,
        xy=np.array(xy),
        branches=Ragged.from_rows(rows),
        kind=tuple(kind),
        source=np.array(source),
        target=np.array(target),
        source_branch=np.array(leave),
        target_branch=np.array(arrive),
        length=np.array(length),
        length_sigma=np.array(sigma),
        traversals=np.array(times),
        paths=paths,
        observation_vertex=seen,
        observation_time_ns=np.arange(len(seen)) * 10**9,
        noise=m.noise,
        info={**m.info, "truth": truth},
    )


def as_others(maps, change):
    """The maps, and what else is made of each: of a world of its own."""
    other = {"world": -1}
    return maps + [replace(c := change(m), run=f"x-{m.run}", info=c.info | other) for m in maps]


def floors(seed, kind="maze", closed=1, off_m=0.0):
    rng = np.random.default_rng(seed)
    plan = make_world(kind, 60, seed)
    worlds = [without_some(moved(plan, off_m, rng), closed, rng) for _ in range(3)]
    return runs_of(worlds, seed)


def shared_block(seed):
    block = make_world("maze", 14, seed + 5000)
    maps = []
    for w in range(3):
        world, inside = with_block(block, 10 * seed + w)
        rng = np.random.default_rng(100 * seed + w)
        away = np.hypot(*(world.xy - world.xy[inside].mean(axis=0)).T)
        for r in range(2):
            cost = away + rng.uniform(0, 8, len(away))
            region = grown(world, set(inside.tolist()), len(inside) + 14, cost, set())
            maps.append(of_world(observed_map(world, region, rng, f"r{r}", SEEING), w))
    return maps


def off_scale(seed, kind="maze", share=0.02):
    rng = np.random.default_rng(seed)
    maps = runs_of([make_world(kind, 80, seed + k) for k in range(2)], seed)
    return [longer(m, 1 + share * rng.choice([-1, 1])) for m in maps]


def phantoms(seed, kind="maze", share=0.25):
    rng = np.random.default_rng(seed)
    maps = runs_of([make_world(kind, 80, seed + k) for k in range(2)], seed)
    return [with_phantoms(m, share, rng) for m in maps]


def made(kind, size=80, seeing=SEEING, worlds=2):
    """Runs in worlds of the simulator."""
    return lambda seed: runs_of(
        [make_world(kind, size, 50 * seed + k) for k in range(worlds)], seed, seeing
    )


def several(world, count=2, seeing=SEEING):
    """Runs in worlds made here."""
    return lambda seed: runs_of([world(10 * seed + k) for k in range(count)], seed, seeing)


def images(kind):
    return lambda seed: as_others(runs_of([make_world(kind, 60, seed)], seed), mirrored)


def copies(kind, factor=1.03):
    return lambda seed: as_others(
        runs_of([make_world(kind, 60, seed)], seed), lambda m: longer(m, factor)
    )


Adversary = Callable[[int], list[TopoMap]]

ADVERSARIES: dict[str, Adversary] = {
    "rows mirrored": images("rows"),
    "tiles mirrored": images("tiles"),
    "office mirrored": images("office"),
    "rows 3 % larger": copies("rows"),
    "tiles 3 % larger": copies("tiles"),
    "maze 3 % larger": copies("maze"),
    "tunnels, harsh": made("tiles", seeing=HARSH),
    "offices, harsh": made("office", seeing=HARSH),
    "rows, harsh": made("rows", seeing=HARSH),
    "floors, a door each": floors,
    "floors, four doors each": lambda seed: floors(seed, closed=4),
    "floors, +- 0.3 m": lambda seed: floors(seed, closed=0, off_m=0.3),
    "office floors, a door": lambda seed: floors(seed, "office"),
    "office floors, +- 0.3 m": lambda seed: floors(seed, "office", 0, 0.3),
    "star": several(lambda seed: star(8, 6, seed)),
    "star, 4 closed": several(lambda seed: star(8, 6, seed, 4)),
    "spiral ramp": several(lambda seed: spiral(7, seed)),
    "honeycomb": several(lambda seed: lattice(9, 12, seed, hexagonal=True)),
    "lattice": several(lambda seed: lattice(9, 9, seed)),
    "lattice with a border": several(lambda seed: lattice(7, 7, seed, stubs=0.6)),
    "equal doors": several(lambda seed: doors(28, seed)),
    "turned four times": several(symmetric),
    "turned twice": several(lambda seed: symmetric(seed, 2)),
    "built twice, mirrored": several(lambda seed: symmetric(seed, image=True)),
    "one standard block": shared_block,
    "mazes of equal cells": several(modular, 3),
    "maze, bent 1.5 m": made("maze", seeing=BENT),
    "tunnels, bent 1.5 m": made("tiles", seeing=BENT),
    "office, bent 1.5 m": made("office", seeing=BENT),
    "maze, scale 2 % off": off_scale,
    "tunnels, scale 2 % off": lambda seed: off_scale(seed, "tiles"),
    "maze, many phantoms": phantoms,
    "tunnels, many phantoms": lambda seed: phantoms(seed, "tiles"),
}


@dataclass
class Score:
    """Counts over batches."""

    wrong: int = 0
    pairs: int = 0
    batches: int = 0
    right: int = 0
    possible: int = 0
    twice: int = 0
    mixed: int = 0

    def __iadd__(self, other):
        for name in self.__dataclass_fields__:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self

    def row(self):
        """Cells of the table."""
        return " | ".join(
            [
                f"{self.wrong} of {self.pairs}",
                f"{wilson(self.wrong, self.pairs):.4f}",
                f"{self.batches * DEFAULT_ROBUST.false_merge_rate:.3g}",
                f"{self.right} of {self.possible}",
                f"{self.twice}, {self.mixed}",
            ]
        )


def wilson(hits, of, z=1.96):
    """The upper end of Wilson's interval."""
    p = hits / of
    middle = p + z * z / (2 * of)
    return (middle + z * np.sqrt(p * (1 - p) / of + z * z / (4 * of * of))) / (1 + z * z / of)


def score(maps, told=None):
    """What merging a batch comes to; wrong pairs are appended to `told`."""
    by_run = {m.run: m for m in maps}
    result = merge_maps(maps)
    part = {run: k for k, c in enumerate(result.components) for run in c.poses}
    out = Score(batches=1)
    for v in result.verdicts:
        a, b = by_run[v.a], by_run[v.b]
        out.pairs += 1
        same = a.info["world"] == b.info["world"]
        if v.accepted and not (same and _fits(v, a, b)):
            out.wrong += 1
            if told is not None:
                told.append((v, a, b))
        common = len(_true(a) & _true(b)) if same else 0
        if common >= max(FEWEST, 0.25 * min(len(a), len(b))):
            out.possible += 1
            out.right += part[v.a] == part[v.b]
    out.twice, out.mixed = _fused(result, by_run)
    return out


def _true(m):
    return {v for v in m.info["truth"] if v >= 0}


def _fits(v, a, b):
    """Whether most matched junctions are the same ones."""
    at_a, at_b = (np.array(m.info["truth"])[v.best.matched[:, k]] for k, m in enumerate((a, b)))
    return np.mean((at_a == at_b) & (at_a >= 0)) >= 0.5


def _fused(result, by_run):
    """How many junctions stand in several vertices of a component, and how many vertices are of
    several junctions; phantoms aside."""
    stands, mixed = defaultdict(set), 0
    for v, (component, members) in enumerate(
        zip(result.fused.component.tolist(), result.fused.members, strict=True)
    ):
        true = {
            (by_run[run].info["world"], t)
            for run, rows in members.items()
            for t in (by_run[run].info["truth"][k] for k in rows)
            if t >= 0
        }
        mixed += len(true) > 1
        for place in true:
            stands[component, place].add(v)
    return sum(len(rows) > 1 for rows in stands.values()), mixed


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="seed of the first batch")
    parser.add_argument("--only", nargs="*", default=[""], help="parts of names of adversaries")
    parser.add_argument("--without", choices=RULES)
    parser.add_argument("--tell", action="store_true", help="say what was merged wrongly")
    options = parser.parse_args()
    leave_out(options.without)
    print("| adversary | judged | wrong | at most | promised | right | twice, mixed |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, maps_of in ADVERSARIES.items():
        if not any(part in name for part in options.only):
            continue
        whole, two, wrong = Score(), Score(), []
        for seed in range(options.first, options.first + options.seeds):
            maps = maps_of(seed)
            whole += score(maps, wrong)
            for pair in combinations(maps, 2):
                two += score(list(pair), wrong)
        print(f"| {name} | one batch | {whole.row()} |")
        print(f"| {name} | two runs | {two.row()} |", flush=True)
        for v, a, b in wrong if options.tell else ():
            print(f"  {a.run} {b.run}: {v.reason}")


if __name__ == "__main__":
    main()
