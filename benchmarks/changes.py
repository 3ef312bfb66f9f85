"""Detection of closed corridors.

    python benchmarks/changes.py [--seeds 5] [--first 0]

Two runs of one world, the second with every tenth corridor closed (as far as the world stays
connected): closed corridors are not driven, and their branches are not seen.

  closed   corridors that the first run drove and that are closed in the second
  met      those of which the second run passed both ends
  told     those reported as a change; unsure: reported as possibly due to chance
  false    reported changes that are none
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from topobatch.ingest.mapping import build_map
from topobatch.merge.changes import changes
from topobatch.merge.merging import merge_maps
from topobatch.simulation.scenario import EPOCH_NS, simulate_run
from topobatch.simulation.settings import DRIFTS, FAULTS, RunSettings
from topobatch.simulation.truth import Truth, true_vertex_of_nodes
from topobatch.simulation.worlds import make_world

KINDS = ("maze", "office", "organic", "city")
DAY_NS = 86_400 * 10**9
COLUMNS = ("worlds", "apart", "closed", "met", "told", "unsure", "false")


def world(kind: str, seed: int, faults: str, closed_share: float) -> np.ndarray:
    """One row of counts, as COLUMNS."""
    made = make_world(kind, 40, seed)
    first = RunSettings(drift=DRIFTS["mid"], faults=replace(FAULTS[faults], closed_share=0.0))
    second = replace(first, faults=replace(first.faults, closed_share=closed_share))
    a = simulate_run(made, None, first, name="a", seed=seed)
    b = simulate_run(made, None, second, name="b", seed=seed + 100, start_ns=EPOCH_NS + DAY_NS)
    maps = {s.run.name: build_map(s.run) for s in (a, b)}
    result = merge_maps(list(maps.values()))
    if len(result.components) > 1:
        return np.array([1, 1, 0, 0, 0, 0, 0])
    truth = Truth({made.name: made}, {"a": a.truth, "b": b.truth})
    true = {run: true_vertex_of_nodes(truth, m) for run, m in maps.items()}
    of_node = [
        {int(true[run][v]) for run, ids in members.items() for v in ids} - {-1}
        for members in result.fused.members
    ]
    ends = [{u, v} for u, v in zip(made.source.tolist(), made.target.tolist(), strict=True)]
    closed = set(b.truth.closed_edges) & set(a.truth.drive_edge.tolist())
    met = {e for e in closed if ends[e] <= b.truth.detected}
    told, unsure, false = set(), set(), 0
    for change in changes(result, 0, maps):
        places = set().union(*(of_node[j] for j in change.junctions))
        hit = {e for e in closed if ends[e] == places} if change.thing == "corridor" else set()
        if change.sure:
            told |= hit
            false += not hit
        else:
            unsure |= hit
    return np.array([1, 0, len(closed), len(met), len(told), len(unsure - told), false])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    args = parser.parse_args()
    start = time.monotonic()
    print(f"{'faults, closed':16}" + "".join(f"{name:>8}" for name in COLUMNS))
    for faults in ("none", "mild", "harsh"):
        for share in (0.1, 0.0):
            rows = [
                world(kind, seed, faults, share)
                for kind in KINDS
                for seed in range(args.first, args.first + args.seeds)
            ]
            print(f"{faults}, {share:<10.1f}" + "".join(f"{n:8}" for n in np.sum(rows, axis=0)))
    print(f"{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
