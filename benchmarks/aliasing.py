"""Perceptual aliasing, in worlds that repeat themselves and one another.

    python benchmarks/aliasing.py [--worlds N] [--first S] [--without RULE] [--mixed]

For every kind of world N worlds of RUNS runs each, merged in one batch, world by world, and two
runs at a time; with --mixed the worlds of all kinds in one batch, judged kind by kind. Right: pairs
with at least FEWEST common junctions that end in one component, by the common share of the smaller
map; wrong: pairs merged at a false placement, or of two worlds. Promised: number of these that the
false-merge rate allows. --without disables one rule (ablation).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import combinations

import numpy as np
from observed import Seeing, scattered_maps

from topobatch.merge.fusion.fuse import components_of
from topobatch.merge.robust import (
    DEFAULT_ROBUST,
    conflicts,
    decide,
    match,
    prepare,
    repetition,
    thresholds,
    verdict,
)
from topobatch.merge.robust.alignment import Hypotheses, evaluate_all
from topobatch.merge.robust.links import Seed
from topobatch.merge.robust.settings import MATCH
from topobatch.simulation.worlds import make_world
from topobatch.topology.se2 import fit_rigid

KINDS = {"tiles": 90, "office": 120, "rows": 70, "maze": 110, "organic": 90, "city": 90}
"""Junctions of a world of each kind."""
RUNS, SIZE, FEWEST = 5, 36, 5
SEEING = Seeing(missed=0.03, branch_fault=0.04, bend_m=0.3)
SHARES = (0.25, 0.5, 1.01)
RULES = ("elsewhere", "small copies", "learned copies", "uniform")
"""What `leave_out` leaves out."""


def batch(kind, worlds, first):
    """Maps of all runs of all worlds; `info` says which vertices of which world they show."""
    out = []
    for w in range(worlds):
        world = make_world(kind, KINDS[kind], first + w)
        for m, _ in scattered_maps(world, RUNS, SIZE, first + w, SEEING):
            truth = {"world": (kind, w), "truth": m.info["truth"]}
            out.append(replace(m, run=f"{kind}-w{w:02d}-{m.run}", info=truth))
    return sorted(out, key=lambda m: m.run)


def score(maps, told=None, kind=""):
    """Counts over the pairs of one batch: right and possible (3,) by share, wrong, pairs. told: the
    verdicts, if known; kind: only pairs with a run in a world of it."""
    by_run = {m.run: m for m in maps}
    told = decide(maps) if told is None else told
    accepted = [v for v in told if v.accepted]
    together = {run: k for k, part in enumerate(components_of(by_run, accepted)) for run in part}
    right, possible, wrong = np.zeros(3, int), np.zeros(3, int), 0
    told = [v for v in told if v.a.startswith(kind) or v.b.startswith(kind)]
    for v in told:
        a, b = by_run[v.a], by_run[v.b]
        same = a.info["world"] == b.info["world"]
        common = len(set(a.info["truth"]) & set(b.info["truth"])) if same else 0
        if v.accepted and not (same and _fits(v, a, b)):
            wrong += 1
        elif common >= FEWEST:
            k = np.searchsorted(SHARES, common / min(len(a), len(b)), side="right")
            possible[k] += 1
            right[k] += together[v.a] == together[v.b]
    return right, possible, wrong, len(told)


def _fits(v, a, b):
    """Whether most matched junctions are the same ones."""
    at_a, at_b = (np.array(m.info["truth"])[v.best.matched[:, k]] for k, m in enumerate((a, b)))
    return np.mean(at_a == at_b) >= 0.5


def added(scores):
    """Scores of several batches as one."""
    return [sum(values) for values in zip(*scores, strict=True)]


def rows(kind, worlds, first):
    """(name, score) of the three ways to judge the same maps."""
    maps = batch(kind, worlds, first)
    yield "one batch", score(maps)
    alone = [[m for m in maps if m.info["world"] == (kind, w)] for w in range(worlds)]
    yield "by world", added(score(part) for part in alone)
    yield "two runs", added(score(list(pair)) for pair in combinations(maps, 2))


def mixed(kinds, worlds, first):
    """(kind, name, score) of the worlds of all kinds in one batch."""
    maps = [m for kind in sorted(kinds) for m in batch(kind, worlds, first)]
    told = decide(maps)
    for kind in kinds:
        yield kind, "all kinds", score(maps, told, kind)


def placements(kind, worlds, first):
    """Of pairs of one world that share at least FEWEST junctions, by share: how many; how many have
    a wrong placement beside the right one; in how many of these the right one has more bits, the
    wrong one more by what merging asks as a lead, and the right one more of the second question."""
    out = np.zeros((3, 5), int)
    for a, b in combinations(batch(kind, worlds, first), 2):
        true_a, true_b = (np.array(m.info["truth"]) for m in (a, b))
        shared, i, j = np.intersect1d(true_a, true_b, return_indices=True)
        if a.info["world"] != b.info["world"] or len(shared) < FEWEST:
            continue
        one, two = prepare(a), prepare(b)
        x, y, theta = fit_rigid(a.xy[i], b.xy[j])
        home = Seed(i, j, float(theta), complex(x, y), 0.0)
        found = [*match(one, two, DEFAULT_ROBUST)]
        tested = round(2.0 ** found[0].tested_bits) if found else 1
        found += next(evaluate_all([Hypotheses(one, two, [home], tested)], DEFAULT_ROBUST))
        copies = repetition.default_copies(DEFAULT_ROBUST)
        told = {True: [(-np.inf, -np.inf)], False: [(-np.inf, -np.inf)]}
        cases = [(one, two, c) for c in found]
        for c, same in zip(found, repetition.sameness(cases, copies), strict=True):
            right = bool(np.mean(true_a[c.a] == true_b[c.b]) >= 0.5)
            told[right].append((c.counted_bits, same.bits))
        right, wrong = (np.max(told[k], axis=0) for k in (True, False))
        beside = bool(np.isfinite(right[0]) and np.isfinite(wrong[0]))
        lead = wrong[0] - right[0] if beside else 0.0
        k = np.searchsorted(SHARES, len(shared) / min(len(a), len(b)), side="right")
        out[k] += (1, beside, lead < 0, lead > MATCH.lead_bits, beside and right[1] > wrong[1])
    return out


def leave_out(rule):
    """Take a rule out of the matcher."""
    if rule == "elsewhere":
        none = (np.zeros(0, np.int64),) * 3
        _replace(conflicts, "_elsewhere", lambda grown, searched, unseen_b, unseen_a: none)
    elif rule == "small copies":
        _replace(verdict.Threshold, "repetition_by_size", lambda self, best: 0.0)
    elif rule == "learned copies":
        for module in (thresholds,):
            _replace(module, "copy_model", lambda _, settings: repetition.default_copies(settings))
    elif rule == "uniform":
        _replace(verdict, "uniformity", lambda a, b: 0.0)


def _replace(where, name, stand_in):
    """Raises AttributeError if there is no such part: nothing would be left out."""
    getattr(where, name)
    setattr(where, name, stand_in)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="seed of the first world")
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--without", choices=RULES)
    parser.add_argument("--mixed", action="store_true", help="all kinds in one batch")
    parser.add_argument("--placements", action="store_true", help="right ones beside wrong ones")
    options = parser.parse_args()
    leave_out(options.without)
    if options.placements:
        print(
            "| world | overlap | pairs | wrong beside right | right has more | wrong leads | "
            "second question: right has more |"
        )
        print("| --- | --- | --- | --- | --- | --- | --- |")
        for kind in options.kinds:
            counts = placements(kind, options.worlds, options.first).tolist()
            for share, row in zip(("< 25 %", "25-50 %", "> 50 %"), counts, strict=True):
                print(f"| {kind} | {share} | {' | '.join(map(str, row))} |", flush=True)
        return
    shares = ("< 25 %", "25-50 %", "> 50 %")
    print(f"| world | judged | {' | '.join(f'right at {s}' for s in shares)} | wrong | promised |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    known = options.worlds, options.first
    alone = ((kind, *row) for kind in options.kinds for row in rows(kind, *known))
    judged = mixed(options.kinds, *known) if options.mixed else alone
    for kind, name, (right, possible, wrong, pairs) in judged:
        cells = " | ".join(f"{r} of {p}" for r, p in zip(right, possible, strict=True))
        batches = {"by world": options.worlds, "two runs": pairs}.get(name, 1)
        promise = batches * DEFAULT_ROBUST.false_merge_rate
        print(f"| {kind} | {name} | {cells} | {wrong} of {pairs} | {promise:.3g} |", flush=True)


if __name__ == "__main__":
    main()
