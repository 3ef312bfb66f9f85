"""Ablation of loop closure: the effect of every mechanism.

    python benchmarks/ablation.py [--seeds 5]

Disables one mechanism at a time, by settings or by replacing a function, and closes the same runs
again: runs of the project's simulator in five kinds of world, by drift and faults (`CELLS`), and
recorded runs (`--real FOLDER…`, as `uncertainty.py` reads them). `runs`: number of runs with
another result; `recall`: share of the passes by a junction passed before that are in one place with
such a pass; then for every kind of world passes in a place that is mostly another junction (false),
and surplus vertices of junctions (double). `--only NAME…` selects mechanisms, `--list` names them
all.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from closure import simulated
from uncertainty import recorded

from topobatch.ingest.mapping import dead_reckoned, identified
from topobatch.ingest.mapping_settings import DEFAULT_MAPPING
from topobatch.simulation import true_vertex_of_passes
from topobatch.topology.closure import (
    alternatives,
    candidates,
    growth,
    incremental,
    joint_compatibility,
    negative_information,
)
from topobatch.topology.closure.dead_reckoning import DeadReckoning
from topobatch.topology.closure.incremental import RoundSettings, full_closure
from topobatch.topology.closure.missed_detections import DrivenBySettings, correct_detections
from topobatch.topology.closure.pieces import set_apart
from topobatch.topology.odometry import Odometry

WORLDS = ("maze", "office", "organic", "city", "rows")
CELLS = (
    ("none", "none"),
    ("low", "harsh"),
    ("mid", "mild"),
    ("high", "none"),
    ("high", "harsh"),
    ("real", "mild"),
)
ALWAYS = 1e9

OUT = {
    "one wrong in all runs": {"wrong_share": 1.0},
    "caution": {"caution": 1.0},
    "grid": {"grid.least_share": 2.0},
    "grid: wander": {"grid.most_wander": ALWAYS},
    "hard core: the shortest": {"candidates.evidence.core_quantile": 0.0},
    "inflation": {"candidates.evidence.inflation": 1.0},
    "rarity: bandwidth": {"candidates.evidence.bandwidth_rad": 0.0},
    "lattice": {"candidates.evidence.pattern.regular": ALWAYS},
    "lead": {"candidates.evidence.lead": 0.0},
    "growth: caps": {
        "candidates.growth.leg_cap": ALWAYS,
        "candidates.growth.branch_cap": ALWAYS,
    },
    "growth: discount": {"candidates.growth.discount": 1.0},
    "growth: known gaps": {"candidates.growth.line_m": 0.0},
    "measured rates": {"rates.prior_passes": ALWAYS},
    "grid kernel": {"estimate.grid_kernel": ALWAYS},
    "closed again": {"most_crossing": ALWAYS},
    "phantoms": {"driven_by.least_odds": ALWAYS},
    "phantoms: straight": {"driven_by.straight_gain": 0.0},
    "phantoms: least miss rate": {"driven_by.least_miss_rate": 1e-6},
    "phantoms: least rate": {"driven_by.least_phantom_rate": 1e-6},
}
"""Mechanisms, and the fields of RoundSettings that disable each (`driven_by`: DrivenBySettings)."""


def _no_growth(state, a, *args):
    """What corridors around tell, if nobody looks at them."""
    return growth.Support(np.zeros(len(a)), np.zeros(len(a)))


def _one_hop(state, a, b, aligned, settings):
    return growth.grow(state, a, b, aligned, replace(settings, hops=1))


REPLACED = {
    # `hops` says, too, how far candidates are looked for: without them there are none.
    "growth": (candidates, "grow", _no_growth),
    "growth: one hop": (candidates, "grow", _one_hop),
    "noise raised": (incremental, "_fitting_scale", lambda now, *args: now),
    "taking back": (incremental, "_outliers", lambda *args: []),
    "joint compatibility": (incremental, "_together", lambda *args: ([], {})),
    "straight corridors": (incremental, "_straight", lambda *args: None),
    "rivals": (incremental, "_rivals", lambda *args: []),
    "null pairs": (candidates, "_null_pairs", lambda *args: np.zeros(0)),
    "negative information": (
        negative_information.DrivenGround,
        "share",
        lambda ground, shift, *args: np.zeros(len(shift)),
    ),
    "joint: one step off": (joint_compatibility, "_one_step_off", lambda *args: -np.inf),
    "closed again: grid off": (alternatives, "closure_without_grid", full_closure),
    "closed again: no repeats": (alternatives, "_repeats", lambda *args: False),
}
"""Mechanisms without such a field: module, function, and its replacement."""


class Case(NamedTuple):
    """Dead reckoning, and the true junction of each of its passes (p,), negative for none."""

    kind: str
    reckoning: DeadReckoning
    odometry: Odometry
    truth: np.ndarray


def case(kind, truth, run):
    """Dead reckoning that `build_map` closes."""
    run, odometry, reckoning, _ = dead_reckoned(run)
    times = reckoning.passes.time_ns
    return Case(kind, reckoning, odometry, true_vertex_of_passes(truth, run.name, times))


def cases(args):
    """All walks that the command asks for, by kind of world."""
    for world in args.worlds:
        for drift, faults in (cell for cell in CELLS if cell[0] in args.drifts):
            for seed in range(args.first, args.first + args.seeds):
                scenario, run = simulated(world, drift, faults, seed, args.junctions)
                yield case(world, scenario.truth, run)
    for folder in args.real:
        truth, runs = recorded(folder)
        for run in runs.values():
            yield case("real", truth, run)


def changed(settings, path, value):
    """Frozen settings with the field at a dotted path replaced."""
    name, _, rest = path.partition(".")
    if rest:
        value = changed(getattr(settings, name), rest, value)
    return replace(settings, **{name: value})


def without(fields):
    """Settings of the rounds and of what is driven by, without a mechanism."""
    rounds, driven_by = RoundSettings(), DrivenBySettings()
    for path, value in fields.items():
        if path.startswith("driven_by."):
            driven_by = changed(driven_by, path.removeprefix("driven_by."), value)
        else:
            rounds = changed(rounds, path, value)
    return rounds, driven_by


@contextmanager
def replaced(name):
    """Without a mechanism of `REPLACED`."""
    if name not in REPLACED:
        yield
        return
    with mock.patch.object(*REPLACED[name]):
        yield


def closed(one, rounds, driven_by):
    """(p,) place of every pass, negative for phantoms."""
    settings = replace(DEFAULT_MAPPING, rounds=rounds)
    found, fit = identified(one.reckoning, one.odometry, settings)
    apart = set_apart(one.reckoning, found.place, fit.estimate)
    return correct_detections(found.reckoning, one.odometry, found.place, apart, driven_by).place


def judged(one, place):
    """Counts of one closed run."""
    real = (one.truth >= 0) & (place >= 0)
    homes = Counter(zip(one.truth[real].tolist(), place[real].tolist(), strict=True))
    most = {p: max(k for (_, q), k in homes.items() if q == p) for _, p in homes}
    false = int(real.sum()) - sum(most.values())
    double = sum(k - 1 for k in Counter(v for v, _ in homes).values())
    seen, found, again = {}, 0, 0
    for v, p in zip(one.truth.tolist(), place.tolist(), strict=True):
        if v >= 0:
            again += v in seen
            found += p >= 0 and p in seen.get(v, ())
            seen.setdefault(v, set()).add(p)
    return Counter(
        {f"false {one.kind}": false, f"double {one.kind}": double, "again": again, "found": found}
    )


def line(name, kinds, total, otherwise, spent):
    cells = " ".join(f"{total[f'false {k}']:>5} {total[f'double {k}']:>5} " for k in kinds)
    recall = total["found"] / max(total["again"], 1)
    print(f"{name:<26} {otherwise:>4} {recall:>7.4f}  {cells} {spent:>6.1f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="*", default=WORLDS)
    parser.add_argument("--drifts", nargs="*", default=sorted({drift for drift, _ in CELLS}))
    parser.add_argument("--seeds", type=int, default=5, help="runs per world and cell")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--junctions", type=int, default=60, help="junctions per run")
    parser.add_argument("--real", nargs="*", type=Path, default=[], help="folders of recorded runs")
    parser.add_argument("--only", nargs="*", help="mechanisms")
    parser.add_argument("--list", action="store_true")
    args = parser.parse_args()
    if args.list:
        print("\n".join([*OUT, *REPLACED]))
        return
    all_cases = list(cases(args))
    kinds = list(dict.fromkeys(one.kind for one in all_cases))
    print(f"{'without':<26} runs  recall  " + " ".join(f"{kind:^12}" for kind in kinds) + "  CPU s")
    usual = None
    for name in ["nothing", *([*OUT, *REPLACED] if args.only is None else args.only)]:
        settings = without(OUT.get(name, {}))
        begin = time.process_time()
        with replaced(name):
            places = [closed(one, *settings) for one in all_cases]
        spent = time.process_time() - begin
        usual = usual or places
        otherwise = sum(not np.array_equal(a, b) for a, b in zip(usual, places, strict=True))
        total = sum((judged(*pair) for pair in zip(all_cases, places, strict=True)), Counter())
        line(name, kinds, total, otherwise, spent)


if __name__ == "__main__":
    main()
