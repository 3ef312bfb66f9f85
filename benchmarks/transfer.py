"""Transfer of named places between maps.

    python benchmarks/transfer.py [--seeds 3] [--first 601]

Simulated runs, two of each world, with places in one's map transferred to the other's and to the
merged one. The truth is the same place in the target's own map: on the same corridor, at the same
share of its length and the same distance to its side ("other", "merged"). For a corridor that the
target never drove ("beyond") it is the world's place, relative to the target's four nearest
junctions.

  carried      share of all places whose stated 95 % bound is within 0.5 m
  ≤ 0.5 m      share of the carried ones with an error of at most this; after it, of all
  68, 95 %     coordinates within 1 and 1.96 of the stated standard deviations
  left, off    places not transferred, and the share of them whose error would exceed 0.5 m

Robots keep to the centre line here (`--wobble 0`): otherwise paths, from which the truth is read,
differ from run to run.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field

import numpy as np

from topobatch.ingest.mapping import build_map
from topobatch.merge.component_map import component_map
from topobatch.merge.merging import merge_maps
from topobatch.merge.transfer import (
    WITHIN_SIGMAS,
    MatchedJunctions,
    junctions_of_merged,
    junctions_of_runs,
    transfer,
)
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import MotionSettings, ScenarioSettings
from topobatch.simulation.truth import Truth, true_vertex_of_nodes
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.polyline import way_of
from topobatch.topology.se2 import apply, fit_rigid
from topobatch.topology.topomap import TopoMap

KINDS = ("maze", "office", "organic", "city")
WITHIN_M = 0.5
SIDE_M = 1.5
"""A place is up to so far beside its corridor."""
INTO = ("other", "merged", "beyond")


@dataclass
class Tally:
    """Errors (k, 2) of all places with their stated sigmas, and what was not merged."""

    off: list[np.ndarray] = field(default_factory=list)
    sigma: list[np.ndarray] = field(default_factory=list)
    apart: int = 0

    def add(self, given: np.ndarray, wanted: np.ndarray, matched: MatchedJunctions) -> None:
        """Places (k, 2) of the source, and where they are in the target."""
        if len(given) and len(matched):
            found = transfer(given, matched)
            self.off.append(found.xy - wanted)
            self.sigma.append(found.sigma_m)


def corridors(
    topomap: TopoMap, true: np.ndarray, truth: Truth, world: str
) -> dict[int, np.ndarray]:
    """Path of each corridor of the world that the map has, along the world's direction."""
    w, out = truth.worlds[world], {}
    ends = np.stack([w.source, w.target], axis=1)
    for e, path in enumerate(topomap.paths):
        u, v = int(true[topomap.source[e]]), int(true[topomap.target[e]])
        for c in np.flatnonzero((np.sort(ends, axis=1) == sorted((u, v))).all(axis=1)).tolist():
            if abs(w.length[c] - topomap.length[e]) < 0.5:
                out.setdefault(c, path if u == ends[c, 0] else path[::-1])
    return out


def place(path: np.ndarray, share: float, side: float) -> np.ndarray:
    """(2,) so far along a path, so far to its left."""
    way = way_of(path)
    steps = np.array([share, np.clip(share - 0.02, 0, 1), np.clip(share + 0.02, 0, 1)]) * way[-1]
    at, before, after = np.column_stack([np.interp(steps, way, path[:, k]) for k in (0, 1)])
    d = (after - before) / max(float(np.hypot(*(after - before))), 1e-9)
    return at + side * np.array([-d[1], d[0]])


def places(
    ways: list[dict[int, np.ndarray]], chance: np.random.Generator, count: int
) -> list[np.ndarray]:
    """(k, 2) of places on the corridors that all have, in each of them."""
    both = sorted(set.intersection(*(set(w) for w in ways)))
    chosen = [
        (int(chance.choice(both)), chance.uniform(), chance.uniform(-SIDE_M, SIDE_M))
        for _ in range(count if both else 0)
    ]
    return [np.array([place(w[c], s, d) for c, s, d in chosen]).reshape(-1, 2) for w in ways]


def as_seen(world: np.ndarray, topomap: TopoMap, true: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(k, 2) places of the world as the four nearest junctions of a map see them."""
    rows = np.flatnonzero(true >= 0)
    out = []
    for p in world:
        near = rows[np.argsort(np.hypot(*(xy[true[rows]] - p).T), kind="stable")[:4]]
        out.append(apply(fit_rigid(topomap.xy[near], xy[true[near]]), p[None])[0])
    return np.array(out).reshape(-1, 2)


def world(
    tallies: dict[str, Tally], kind: str, drift: str, seed: int, *, count: int, wobble_m: float
) -> None:
    """Two runs of one world, places of each carried to the other and to what they are together."""
    motion = MotionSettings(wobble_m=wobble_m)
    scenario = simulate_scenario(
        ScenarioSettings(
            kind, runs=2, overlap=0.5, junctions_per_run=40, drift=drift, seed=seed, motion=motion
        )
    )
    truth, chance = scenario.truth, np.random.default_rng(seed)
    maps = {
        name: map_from_document(map_to_document(build_map(run)))
        for name, run in scenario.runs.items()
    }
    result = merge_maps(list(maps.values()))
    if len(result.components) > 1:
        for tally in tallies.values():
            tally.apart += 2
        return
    name = next(iter(truth.worlds))
    true = {run: true_vertex_of_nodes(truth, m) for run, m in maps.items()}
    ways = {run: corridors(m, true[run], truth, name) for run, m in maps.items()}
    a, b = sorted(maps)
    fused = component_map(result, 0, "merged", maps)
    members = fused.info["members"]["nodes"]
    of_fused = [{int(true[r][v]) for r in m for v in m[r]} - {-1} for m in members]
    fused_true = np.array([min(s) if len(s) == 1 else -1 for s in of_fused])
    fused_ways = corridors(fused, fused_true, truth, name)
    real = dict(enumerate(truth.worlds[name].paths))
    for one, other in ((a, b), (b, a)):
        matched = junctions_of_runs(result, maps, one, other)
        tallies["other"].add(*places([ways[one], ways[other]], chance, count), matched)
        alone = {c: path for c, path in ways[one].items() if c not in ways[other]}
        given, there = places([alone, real], chance, count)
        seen = as_seen(there, maps[other], true[other], truth.worlds[name].xy)
        tallies["beyond"].add(given, seen, matched)
        matched = junctions_of_merged(result, maps[one], fused)
        tallies["merged"].add(*places([ways[one], fused_ways], chance, count), matched)


def line(name: str, tally: Tally) -> str:
    """One row of the table."""
    if not tally.off:
        return f"{name:14} nothing merged"
    off, sigma = np.concatenate(tally.off), np.concatenate(tally.sigma)
    far = np.hypot(*off.T) > WITHIN_M
    fine = WITHIN_SIGMAS * sigma <= WITHIN_M
    z = np.abs(off / sigma[:, None])
    left = f"{(~fine).sum():5} {np.mean(far[~fine]):6.3f}" if (~fine).any() else f"{0:5} {'-':>6}"
    return (
        f"{name:14} {len(off):6} {fine.mean():8.3f} {1 - far[fine].mean():8.3f} "
        f"{1 - far.mean():6.3f} {np.mean(z < 1):6.3f} {np.mean(z < 1.96):6.3f}  {left}  "
        f"{np.median(sigma):6.3f} {np.median(np.hypot(*off.T)):6.3f} {tally.apart:5}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=601)
    parser.add_argument("--places", type=int, default=50, help="per run and target")
    parser.add_argument("--wobble", type=float, default=0.0, help="[m], 1 sigma")
    parser.add_argument("--drifts", nargs="*", default=["none", "low", "mid", "high"])
    args = parser.parse_args()
    print(
        "drift, into    places  carried  ≤ 0.5 m    all   68 %   95 %   left    off   "
        "sigma    off  apart"
    )
    start = time.monotonic()
    for drift in args.drifts:
        tallies = {name: Tally() for name in INTO}
        for kind in KINDS:
            for seed in range(args.first, args.first + args.seeds):
                world(tallies, kind, drift, seed, count=args.places, wobble_m=args.wobble)
        for name, tally in tallies.items():
            print(line(f"{drift}, {name}", tally), flush=True)
    print(f"{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
