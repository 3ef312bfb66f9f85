"""The whole processing chain on simulated runs, compared with the truth.

    python benchmarks/chain.py [--seeds N] [--first SEED] [--only TEXT] [--junctions N]

For each kind of scenario, summed over seeds: map nodes of several places; places with several
nodes; pairs merged rightly (common places within 1 m on average, and 5 degrees, of the best rigid
fit of the two maps), wrongly, or not at all; runs joined though they share no chain of overlaps;
CPU seconds per run and per pair.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from itertools import combinations

import numpy as np

from topobatch.ingest.mapping import build_map
from topobatch.merge.merging import merge_maps
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.truth import MIXED, placement_error, true_vertex_of_nodes
from topobatch.topology.se2 import between

LEVELS = (("low", "none"), ("mid", "mild"), ("high", "harsh"), ("real", "mild"))
OVERLAPS = (0.15, 0.3, 0.6)
LEAST_COMMON = 5
"""Pairs with fewer common junctions count neither as missed nor, placed rightly, as wrong."""


def judge(settings: ScenarioSettings) -> Counter[str]:
    """What came of one scenario, counted."""
    scenario = simulate_scenario(settings)
    truth, out = scenario.truth, Counter[str]()
    clock = time.process_time()
    maps = {name: build_map(run) for name, run in scenario.runs.items()}
    out["run_s"] = time.process_time() - clock
    for topomap in maps.values():
        vertex = true_vertex_of_nodes(truth, topomap)
        places = set(vertex[vertex >= 0].tolist())
        out["runs"] += 1
        out["places"] += len(places)
        out["mixed"] += int(np.count_nonzero(vertex == MIXED))
        out["split"] += int(np.count_nonzero(vertex >= 0)) - len(places)
    clock = time.process_time()
    merged = merge_maps(list(maps.values()))
    out["pair_s"] = time.process_time() - clock
    place = {run: (c.id, pose) for c in merged.components for run, pose in c.poses.items()}
    for a, b in combinations(sorted(maps), 2):
        out[verdict_on(truth, maps, place, a, b)] += 1
        out["pairs"] += 1
    return out


def verdict_on(truth, maps, place, a, b):
    """Where two runs ended up, in a word."""
    together = place[a][0] == place[b][0]
    common = len(truth.common(a, b))
    if common < LEAST_COMMON:
        linked = any({a, b} <= group for group in truth.linked())
        return "false" if together and not linked else "apart"
    if not together:
        return "missed"
    try:
        found = between(place[a][1], place[b][1])
        metres, radians = placement_error(truth, maps[a], maps[b], found)
    except ValueError:
        return "wrong"
    return "right" if metres < 1.0 and radians < np.radians(5) else "wrong"


COLUMNS = ("places", "mixed", "split", "right", "wrong", "missed", "false")


def row(name, total):
    """One line of the table."""
    counts = "".join(f"{total[column]:7}" for column in COLUMNS)
    times = f"{total['run_s'] / total['runs']:8.2f}{total['pair_s'] / total['pairs']:8.3f}"
    return f"{name:26}{counts}{times}"


def main() -> None:
    """Print one line per kind of scenario."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--only", default="")
    parser.add_argument("--junctions", type=int, default=50)
    args = parser.parse_args()
    print(f"{'scenario':26}" + "".join(f"{c:>7}" for c in COLUMNS) + "   s/run  s/pair")
    for world in ("maze", "organic", "office", "city"):
        for drift, faults in LEVELS:
            for overlap in OVERLAPS:
                name = f"{world} {drift} {faults} {overlap:.0%}"
                if args.only not in name:
                    continue
                total = Counter[str]()
                for seed in range(args.first, args.first + args.seeds):
                    total += judge(
                        ScenarioSettings(
                            world=world,
                            runs=3,
                            overlap=overlap,
                            junctions_per_run=args.junctions,
                            unrelated_runs=1,
                            drift=drift,
                            faults=faults,
                            seed=seed,
                        )
                    )
                print(row(name, total), flush=True)


if __name__ == "__main__":
    main()
