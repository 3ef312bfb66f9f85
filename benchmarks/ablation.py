"""Ablation of loop closure and odometry: the effect of every mechanism.

    python benchmarks/ablation.py [--seeds 1] [--whole] [--real FOLDER…] [--laser FOLDER…]

Disables one mechanism at a time, by settings or by replacing a function, and maps the same runs
again: runs of the project's simulator in six kinds of world, by drift and faults (`CELLS`), with
and without a jump of the odometry; recorded runs with detections (`--real`, as `uncertainty.py`
reads them) and with a laser (`--laser`, as `laser.py` does). Per mechanism:

  runs     runs whose map is another one; `closed`: those with other places among them
  recall   share of the pairs of passes by one junction that are in one vertex
  false    pairs of passes in one vertex that were by two junctions
  per kind of world: false, and pairs of passes by one junction in two vertices (missed)
  vertices, edges: of all maps
  sigma    stated position sigmas, as a factor (geometric mean over maps) of those of the product;
           `length`, `near`, `place`: % of the errors within 68.3 % intervals (`uncertainty.py`)

`--only NAME…` selects mechanisms, `--list` names them all. Those of the odometry are tried with
all of `build_map`; those of closure start from the dead reckoning that the product makes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from closure import as_read, simulated
from laser import logs, true_centres
from uncertainty import judge_map, recorded

from topobatch.ingest import mapping, pass_source
from topobatch.ingest.mapping import build_map_with_errors, dead_reckoned
from topobatch.ingest.odometry import calibration, heading_likelihood, motion_errors
from topobatch.ingest.odometry.heading_evidence import Rows
from topobatch.ingest.scans import detection
from topobatch.ingest.scans.views import closed_by_views
from topobatch.simulation.settings import DRIFTS, FAULTS
from topobatch.simulation.truth import Truth, true_vertex_of_passes
from topobatch.topology.arrays import BoolArray, FloatArray, IntArray
from topobatch.topology.closure import (
    alternatives,
    candidates,
    estimate,
    growth,
    incremental,
    lattice,
    manhattan,
    missed_detections,
    negative_information,
    resolution,
    variance_components,
    view_loops,
)
from topobatch.topology.closure import evidence as closure_evidence
from topobatch.topology.document import map_to_document
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections, Run

WORLDS = ("maze", "office", "organic", "city", "rows", "tiles")
CELLS = (
    ("none", "none"),
    ("low", "harsh"),
    ("mid", "mild"),
    ("high", "none"),
    ("high", "harsh"),
    ("real", "mild"),
    ("mid", "invented"),
    ("jumps", "mild"),
)
LEVELS = {
    "jumps": replace(DRIFTS["mid"], jumps=1, jump_m=0.5, jump_deg=30.0, resets_per_100_m=0.05),
    "invented": replace(FAULTS["mild"], phantom_rate=0.08, missed_pass_rate=0.1),
}
"""Levels that the simulator has no name for: a jump and resets of the odometry's frame; a detector
that invents and misses many junctions."""
ONE_PLACE_M, APART_M = 0.6, 2.0
"""Passes of runs with a laser nearer to each other than this were by one junction, farther by two,
as in `laser.py`."""
ALWAYS = 1e9
STATED = ("length", "near", "far", "place", "heading")

NUMBERS: dict[str, dict[str, float]] = {
    "caution": {"ROUNDS.caution": 1.0},
    "grid": {"RECTILINEAR.least_share": 2.0},
    "grid: wander": {"RECTILINEAR.most_wander": ALWAYS},
    "hard core: the shortest": {"EVIDENCE.core_quantile": 0.0},
    "inflation": {"EVIDENCE.inflation": 1.0},
    "rarity: bandwidth": {"EVIDENCE.bandwidth_rad": 0.0},
    "lattice": {"LATTICE.regular": ALWAYS},
    "lead": {"EVIDENCE.lead": 0.0},
    "growth: discount": {"GROWTH.discount": 1.0},
    "grid kernel": {"ESTIMATE.grid_kernel": ALWAYS},
    "closed again": {"ROUNDS.most_crossing": ALWAYS},
    "closed again: strict": {"ROUNDS.strict_wrong_share": 0.1},
    "phantoms": {"PHANTOM.least_odds": ALWAYS},
    "phantoms: straight": {"PHANTOM.straight_gain": 0.0},
    "views: loops": {"VIEW_LOOPS.tests": 0},
    "views: doubt": {"VIEW_LOOPS.doubt": 1.0},
}
"""Mechanisms, and the numbers that disable each: a constant of `CONSTANTS`, and a field of it."""

CONSTANTS = {
    "ROUNDS": incremental.ROUNDS,
    "RECTILINEAR": manhattan.RECTILINEAR,
    "EVIDENCE": closure_evidence.EVIDENCE,
    "LATTICE": lattice.LATTICE,
    "GROWTH": growth.GROWTH,
    "ESTIMATE": estimate.ESTIMATE,
    "PHANTOM": missed_detections.PHANTOM,
    "VIEW_LOOPS": view_loops.VIEW_LOOPS,
}


def other_numbers(fields):
    """Patches of the constants with these fields, in all modules that use them."""
    for path, value in fields.items():
        name, field = path.split(".")
        constant = CONSTANTS[name]
        for module in list(sys.modules.values()):
            if getattr(module, name, None) is constant:
                yield module, name, replace(constant, **{field: value})


def _none(*args: Any, **more: Any) -> None:
    return None


def _zeros(of: int):
    """A function that gives as many zeros as its argument at this index is long."""
    return lambda *args, **more: np.zeros(len(args[of]))


def _one_hop(state, a, b, aligned):
    with mock.patch.object(growth, "HOPS", 1):
        return growth.grow(state, a, b, aligned)


def _no_missed(state, front, pairs):
    none = np.zeros(0, np.int64)
    return growth.take(pairs, none), none


def _evidence_without(part):
    """`heading_evidence` without one of its two kinds."""

    def evidence(*args):
        found = _heading_evidence(*args)
        rows = getattr(found, part)
        none = np.zeros(0, np.int64)
        return replace(found, **{part: Rows(rows.y[:0], rows.a[:0], none, rows.share[:0], none)})

    return evidence


_motion = motion_errors.motion_errors
_heading_evidence = calibration.heading_evidence


def _motion_without(*names):
    """`motion_errors` that applies none of the named corrections."""

    def errors(*args):
        found = _motion(*args)
        if found is None:
            return None
        return replace(found, **{n: replace(getattr(found, n), applied=0.0) for n in names})

    return errors


REPLACED = {
    # `HOPS` says, too, how far candidates are looked for: without them there are none.
    "growth": (candidates, "grow", lambda s, a, *args: (*np.zeros((2, len(a))),)),
    "growth: one hop": (candidates, "grow", _one_hop),
    "growth: missed junctions": (growth, "_past_missed", _no_missed),
    "measured rates": (incremental, "measured_rates", lambda places, noise: noise),
    "noise raised": (incremental, "_fitting_scale", lambda now, *args: now),
    "taking back": (incremental, "_outliers", lambda *args: []),
    "joint compatibility": (incremental, "_together", lambda *args: ([], {})),
    "straight corridors": (incremental, "grid_corridors", _none),
    "null pairs": (candidates, "_null_pairs", lambda *args: np.zeros(0)),
    "neighbours": (candidates, "among_neighbours", lambda common, odds, *args: odds),
    "negative information": (negative_information.DrivenGround, "share", _zeros(1)),
    "closed again: grid off": (alternatives, "closure_without_grid", incremental.full_closure),
    "closed again: no repeats": (alternatives, "_repeats", lambda *args: False),
    "passed: along branches": (
        missed_detections,
        "_along_branches",
        lambda track, places, near, row: np.ones(len(row), bool),
    ),
    "resolution": (
        missed_detections,
        "join_below_resolution",
        lambda reckoning, place, estimate, resolution_m: resolution.join_below_resolution(
            reckoning, place, estimate, 0.0
        ),
    ),
    "fitted noise: level": (variance_components, "_odometry_level", lambda *args: 1.0),
    "errors shared by passes": (mapping, "shared_centre_sigma", lambda *args: None),
}
"""Mechanisms without such a field: module or class, function, and its replacement."""

WHOLE = {
    "calibration": (pass_source, "calibrate", lambda *args: calibration.Calibration()),
    "calibration: lag": (
        calibration,
        "CALIBRATION",
        replace(calibration.CALIBRATION, prior_lag_s=1e-6),
    ),
    "calibration: shared errors": (
        heading_likelihood.HeadingLikelihood,
        "scores",
        lambda likelihood, x: np.zeros((1, 3)),
    ),
    "calibration: grid": (calibration, "heading_evidence", _evidence_without("grid")),
    "calibration: passes": (calibration, "heading_evidence", _evidence_without("passes")),
    "lengths": (mapping, "motion_errors", _motion_without("length_scale")),
    "lever": (mapping, "motion_errors", _motion_without("lever_x_m", "lever_y_m")),
    "motion: walk": (
        motion_errors,
        "_walk_covariance",
        lambda walked, away, noise: np.zeros((*walked.shape, *walked.shape[1:])),
    ),
}
"""The same of the odometry, which dead reckoning rests on."""


def _search_without(name, replacement):
    return partial(mock.patch.object, view_loops._Search, name, replacement)


VIEWS = {
    "views: copies": _search_without("_copy_z", lambda search, null: -np.inf),
    "views: support": _search_without(
        "_support", lambda search, tested, rows, odds: np.zeros(len(rows))
    ),
    "views: position": _search_without("_position_odds", lambda search, T, *args: np.zeros(len(T))),
    "views: leads": _search_without(
        "_leads", lambda search, likely, total: np.ones(len(likely), bool)
    ),
}
"""The same of the loops that views close."""


class Case(NamedTuple):
    """A run, what the product makes of it before closure, and its truth: pairs of passes by one
    junction or by two, given the times of passes; and, where the world is known, what
    `uncertainty.py` judges by."""

    kind: str
    run: Run
    reckoned: tuple[Any, ...]
    pairs: Callable[[IntArray], tuple[BoolArray, BoolArray]]
    truth: Truth | None = None
    headings: dict[str, Any] | None = None
    views: tuple[Any, ...] | None = None


class ByJunction(NamedTuple):
    """Pairs of passes by the junctions of a world."""

    truth: Truth
    run: str

    def __call__(self, time_ns):
        v = true_vertex_of_passes(self.truth, self.run, time_ns)
        known = (v[:, None] >= 0) & (v >= 0)
        same = v[:, None] == v
        return known & same, known & ~same


class ByPosition(NamedTuple):
    """Pairs of passes by where they were."""

    time_ns: IntArray
    centre: FloatArray

    def __call__(self, time_ns):
        rows = np.minimum(np.searchsorted(self.time_ns, time_ns), len(self.time_ns) - 1)
        apart = np.hypot(*(self.centre[rows][:, None] - self.centre[rows]).T)
        return apart < ONE_PLACE_M, apart > APART_M


def of_world(kind, truth, run, headings=None):
    """The case of a run whose world is known."""
    headings = headings or {name: world.branches for name, world in truth.worlds.items()}
    return Case(kind, run, dead_reckoned(run), ByJunction(truth, run.name), truth, headings)


def of_laser(log):
    """The case of a log with a laser."""
    given = []

    def closed(*args):
        given.append(args)
        return closed_by_views(*args)

    with mock.patch.object(detection, "closed_by_views", closed):
        result = detection.detect(log.odometry, log.scans, may_lag=False)
    none = Detections(np.zeros(0, np.int64), np.zeros((0, 2)), Ragged.from_rows([]))
    run = Run(log.name, result.odometry, none, scanned=result.scanned)
    pairs = ByPosition(result.scanned.passes.time_ns, true_centres(log, result))
    return Case("laser", run, dead_reckoned(run), pairs, views=given[0])


def cases(args):
    """All runs that the command asks for."""
    for world in args.worlds:
        for drift, faults in (cell for cell in CELLS if cell[0] in args.drifts):
            for seed in range(args.first, args.first + args.seeds):
                levels = (LEVELS.get(level, level) for level in (drift, faults))
                scenario, run = simulated(world, *levels, seed, args.junctions)
                yield of_world(world, scenario.truth, as_read(run))
    for folder in args.real:
        truth, runs, headings = recorded(folder)
        for run in runs.values():
            yield of_world("real", truth, run, headings)
    for folder in args.laser:
        yield from map(of_laser, logs(folder))


class Outcome(NamedTuple):
    """The map of a run: a digest of its document, its places, and what it states."""

    digest: bytes
    place: bytes
    counts: Counter
    sigma: float
    within: dict[str, tuple[int, int]]


def outcome(one, name, seed, usual=None):
    """What comes of a run without a mechanism; `usual`, if that is the same map."""
    patches = [*other_numbers(NUMBERS.get(name, {}))]
    run = one.run
    patches += [REPLACED[name]] if name in REPLACED else []
    patches += [WHOLE[name]] if name in WHOLE else []
    if name.startswith("views"):
        if one.views is None:
            return usual
        with ExitStack() as stack:
            for patch in patches:
                stack.enter_context(mock.patch.object(*patch))
            if name in VIEWS:
                stack.enter_context(VIEWS[name]())
            odometry, views, loops = closed_by_views(*one.views)
        scanned = replace(run.scanned, views=views, loops=loops)
        run = replace(run, odometry=odometry, scanned=scanned)
    elif name not in WHOLE:
        patches += [(mapping, "dead_reckoned", lambda *args: one.reckoned)]
    with ExitStack() as stack:
        for patch in patches:
            stack.enter_context(mock.patch.object(*patch))
        topomap, errors = build_map_with_errors(run)
    doc = map_to_document(topomap)
    for left_out in ("settings", "closures"):  # settings differ, and odds with them
        doc["graph"].pop(left_out, None)
    digest = hashlib.sha256(json.dumps(doc, sort_keys=True).encode()).digest()
    if usual is not None and digest == usual.digest:
        return usual
    return judged(one, topomap, errors, seed, digest)


def judged(one, topomap, errors, seed, digest):
    """What comes of a run whose map has this digest."""
    node = topomap.observation_vertex
    upper = np.triu(np.ones((len(node), len(node)), bool), 1)
    same, other = (upper & pairs for pairs in one.pairs(topomap.observation_time_ns))
    together = node[:, None] == node
    counts = Counter(
        {
            "pairs": int(same.sum()),
            "found": int((same & together).sum()),
            f"missed {one.kind}": int((same & ~together).sum()),
            f"false {one.kind}": int((other & together).sum()),
            "vertices": len(topomap),
            "edges": len(topomap.source),
        }
    )
    within = {}
    if one.truth is not None and topomap.pieces == 1:
        rows = judge_map(one.truth, topomap, errors, seed, one.headings)
        within = {k: (int(rows[k][:, 0].sum()), len(rows[k])) for k in STATED if k in rows}
    sigma = float(np.mean(np.log(topomap.position_sigma))) if len(topomap) else 0.0
    places = np.stack([topomap.observation_time_ns, node]).tobytes()
    return Outcome(digest, places, counts, sigma, within)


def line(name, kinds, usual, found, spent):
    pairs = list(zip(usual, found, strict=True))
    total = sum((new.counts for new in found), Counter())
    cells = [f"{sum(a.digest != b.digest for a, b in pairs):>4}"]
    cells += [f"{sum(a.place != b.place for a, b in pairs):>6}"]
    cells += [f"{total['found'] / max(total['pairs'], 1):>6.4f}"]
    cells += [f"{total[f'false {k}']:>4} {total[f'missed {k}']:>5}" for k in kinds]
    cells += [f"{total['vertices']:>8} {total['edges']:>5}"]
    cells += [f"{np.exp(np.mean([b.sigma - a.sigma for a, b in pairs])):>5.3f}"]
    for quantity in STATED:
        rows = np.array([new.within[quantity] for new in found if quantity in new.within])
        hit, of = rows.sum(axis=0) if len(rows) else (0, 1)
        cells.append(f"{100 * hit / of:>6.1f}")
    print(f"{name:<30}", *cells, f"{spent:>6.1f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="*", default=WORLDS)
    parser.add_argument("--drifts", nargs="*", default=sorted({drift for drift, _ in CELLS}))
    parser.add_argument("--seeds", type=int, default=1, help="runs per world and cell")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--junctions", type=int, default=45, help="junctions per run")
    parser.add_argument("--real", nargs="*", type=Path, default=[], help="recorded, detections")
    parser.add_argument("--laser", nargs="*", type=Path, default=[], help="recorded, laser")
    parser.add_argument("--only", nargs="*", help="mechanisms")
    parser.add_argument("--list", action="store_true")
    args = parser.parse_args()
    every = [*NUMBERS, *REPLACED, *WHOLE, *VIEWS]
    if args.list:
        print("\n".join(every))
        return
    compare(list(cases(args)), every if args.only is None else args.only)


def compare(every, names):
    """A line for the product, and one without each of the named mechanisms."""
    kinds = list(dict.fromkeys(one.kind for one in every))
    head = f"{'without':<30} runs closed recall " + " ".join(f"{kind:^10}" for kind in kinds)
    print(head + f" vertices edges sigma {' '.join(f'{name:>6}' for name in STATED)}  CPU s")
    usual = None
    for name in ["nothing", *names]:
        begin = time.process_time()
        before = usual or [None] * len(every)
        found = [outcome(one, name, k, before[k]) for k, one in enumerate(every)]
        usual = usual or found
        line(name, kinds, usual, found, time.process_time() - begin)


if __name__ == "__main__":
    main()
