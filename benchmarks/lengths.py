"""Distances between neighbouring junctions in maps, and the best possible from their logs.

python benchmarks/lengths.py [--seeds 4] [--first 6100]

Two runs in every world, mid drift and mild faults. For every corridor of each run's map whose ends
are two junctions of the world, the straight distance of these is compared with the truth:

  map      in the map
  ideal    by the pose graph of the same passes (and the same grid of the building) with the true
           place of each pass and the simulator's noise: the maximum likelihood estimate, whose
           variance is the least of unbiased ones for normal errors (Cramér-Rao bound)
  stated   standard deviation by that graph, with the scale of the odometry

Each: the root mean square error [m], and the share within 2 %; `bias` is the median of the
corridor's length over the true one, minus 1, by straightness: line over length.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from topobatch.ingest.mapping import build_map, close_loops, dead_reckoned
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import DRIFTS, FAULTS, ScenarioSettings
from topobatch.simulation.truth import Truth, true_vertex_of_nodes, true_vertex_of_passes
from topobatch.topology.closure.certainty import place_errors
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.passes import Passes
from topobatch.topology.run import Run
from topobatch.topology.topomap import RunNoise

KINDS = ("maze", "office", "organic", "city", "rows")
CLASSES_M = (0.0, 5.0, 10.0, 20.0, np.inf)
STRAIGHT = (0.0, 0.9, 0.98, 0.9995, 1.01)


@dataclass
class Row:
    """One corridor: true distance of its ends, errors of both estimates and 1 sigma [m]; its true
    length, and that of the map."""

    kind: str
    distance: float
    off: float
    ideal: float
    sigma: float
    length: float
    stated: float


def true_noise(passes: Passes) -> RunNoise:
    """What the simulator added, as a run states it: half of the variance of a reading is common to
    all messages of its pass."""
    drift, faults = DRIFTS["mid"], FAULTS["mild"]
    share = np.sqrt(0.5 + 0.5 / np.median(passes.messages))
    return RunNoise(
        along_m_per_sqrt_m=drift.along_m_per_sqrt_m,
        heading_rad_per_sqrt_m=float(np.radians(drift.heading_deg_per_sqrt_m)),
        heading_rad_per_sqrt_rad=float(np.radians(drift.heading_deg_per_sqrt_rad)),
        scale=drift.scale_sigma,
        centre_m=float(share * faults.centre_m),
        branch_rad=float(share * np.radians(faults.branch_deg)),
    )


def rows_of(kind: str, run: Run, truth: Truth) -> list[Row]:
    """The corridors of one run."""
    topomap = build_map(run)
    of = true_vertex_of_nodes(truth, topomap)
    world = truth.worlds[truth.runs[run.name].world]
    run, odometry, reckoning, _ = dead_reckoned(run)
    passes = reckoning.passes
    vertex = true_vertex_of_passes(truth, run.name, passes.time_ns)
    known = np.unique(vertex[vertex >= 0])
    place = np.where(vertex >= 0, np.searchsorted(known, vertex), -1)
    told = dead_reckoning(odometry, passes, true_noise(passes))
    closed, fit = close_loops(reckoning, odometry)
    ideal = optimise(told, place, closed.estimate.pose, grid=fit.grid)
    errors = place_errors(told, ideal, place, np.arange(len(known)), fit.grid)
    between: dict[frozenset[int], list[int]] = {}
    for edge, ends in enumerate(zip(world.source.tolist(), world.target.tolist(), strict=True)):
        between.setdefault(frozenset(ends), []).append(edge)
    out = []
    for e, (u, v) in enumerate(zip(topomap.source, topomap.target, strict=True)):
        a, b = int(of[u]), int(of[v])
        edges = between.get(frozenset((a, b)), [])
        if a < 0 or b < 0 or not edges or not np.isin((a, b), known).all():
            continue
        i, j = np.searchsorted(known, (a, b))
        true = float(np.hypot(*(world.xy[a] - world.xy[b])))
        lengths = world.length[edges]
        out.append(
            Row(
                kind,
                true,
                float(np.hypot(*(topomap.xy[u] - topomap.xy[v]))) - true,
                float(np.hypot(*(ideal.xy[i] - ideal.xy[j]))) - true,
                float(errors.distance_sigma(ideal.xy, np.array([i]), np.array([j]))[0]),
                float(lengths[np.abs(lengths - topomap.length[e]).argmin()]),
                float(topomap.length[e]),
            )
        )
    return out


def line(name: str, rows: list[Row]) -> str:
    """One row of the table."""
    off, ideal, sigma, true = (
        np.array([getattr(r, x) for r in rows]) for x in ("off", "ideal", "sigma", "distance")
    )
    cells = [f"{np.sqrt(np.mean(x**2)):7.4f}" for x in (off, ideal, sigma)]
    cells += [f"{np.mean(np.abs(x) <= 0.02 * true):7.3f}" for x in (off, ideal)]
    return f"{name:20} {len(rows):6} {' '.join(cells)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=6100)
    args = parser.parse_args()
    rows: list[Row] = []
    for kind in KINDS:
        for seed in range(args.first, args.first + args.seeds):
            scenario = simulate_scenario(
                ScenarioSettings(kind, runs=2, overlap=0.5, junctions_per_run=40, seed=seed)
            )
            for run in scenario.runs.values():
                rows += rows_of(kind, run, scenario.truth)
    print(f"{'':20} {'n':>6} {'map':>7} {'ideal':>7} {'stated':>7} {'map':>7} {'ideal':>7}")
    for kind in KINDS:
        print(line(kind, [r for r in rows if r.kind == kind]))
    for least, most in pairwise(CLASSES_M):
        print(line(f"{least:g} to {most:g} m", [r for r in rows if least <= r.distance < most]))
    print(line("together", rows))
    for least, most in pairwise(STRAIGHT):
        some = [r for r in rows if least <= r.distance / r.length < most]
        bias = np.median([r.stated / r.length - 1 for r in some])
        print(f"line over way {least:g} to {most:g}: {len(some)} corridors, bias {bias:+.4f}")


if __name__ == "__main__":
    main()
