"""Upper bound of the evidence that a pair of runs can have.

    python benchmarks/bound.py [--kinds rows] [--worlds N] [--first S] [--size K] [--others M]

The evidence for one place is what both runs saw there, here known without error: the junctions in
both regions, to `TOLERANCE_M`, with their branches. This set is searched for elsewhere. If it
occurs again in its own world, no matcher can tell the two places apart. Its expected number of
occurrences in each of M other worlds of the same kind, as -log2, is its evidence for a matcher that
knows the distribution of worlds; one that does not cannot have more. Merging needs log2(pairs /
rate): 14.8 bits in a batch of eight runs.
"""

from __future__ import annotations

import argparse
from functools import partial
from itertools import combinations

import numpy as np
from observed import scattered_regions
from scipy.spatial import cKDTree

from topobatch.merge.robust import DEFAULT_ROBUST
from topobatch.merge.robust.verdict import needed_bits
from topobatch.simulation.chance import Chance
from topobatch.simulation.worlds import make_world
from topobatch.topology.se2 import wrap

KINDS = {"rows": 80, "office": 120, "tiles": 90, "maze": 110}
"""Junctions of a world of each kind whose corridors are straight, or come in standard pieces: what
corridors tell beside their ends is not looked at."""
RUNS, FEWEST = 4, 5
TOLERANCE_M, BRANCH_RAD = 0.5, 0.26
"""Errors of two maps of one place are no larger: of junctions laid over each other by one
transform, and of branches (5 sigmas)."""


def places_of(world, some, other, tree):
    """How often the junctions `some` of a world lie in `other`, whose points the tree holds."""
    rows = [np.array(world.branches[v]) for v in some]
    count = np.array([len(row) for row in rows])
    there = other.branches.counts
    if not np.isin(count, there).all():
        return 0
    rare = min(range(len(some)), key=lambda k: np.count_nonzero(there == count[k]))
    z = _complex(world.xy[some])
    at, turn = _first_placements(
        z[rare], rows[rare][0], other, np.flatnonzero(there == count[rare])
    )
    arm = z - z[rare]
    for order in (np.abs(arm).argsort()[-2:], np.arange(len(some))):  # the farthest fail soonest
        laid = at[:, None] + np.exp(1j * turn)[:, None] * arm[order]
        gap, nearest = tree.query(np.stack([laid.real, laid.imag], -1), k=1)
        fits = (gap < TOLERANCE_M).all(axis=1)
        at, turn, nearest = at[fits], turn[fits], nearest[fits]
    found = 0
    for angle, vertices in zip(turn, nearest.tolist(), strict=True):
        pairs = zip(rows, vertices, strict=True)
        found += all(_alike(row + angle, np.array(other.branches[w])) for row, w in pairs)
    return found


def _first_placements(z, heading, other, vertices):
    """Where one junction comes to lie, and the turn, if it lies on any of some others."""
    pairs = [(v, float(wrap(h - heading))) for v in vertices.tolist() for h in other.branches[v]]
    of, turn = (np.array(column) for column in zip(*pairs, strict=True))
    return _complex(other.xy[of.astype(int)]), turn


def _complex(xy):
    return xy[:, 0] + 1j * xy[:, 1]


def _alike(one, two):
    """Do two junctions show the same branches?"""
    if len(one) != len(two):
        return False
    gap = np.abs(wrap(one[:, None] - two))
    return bool(gap.min(axis=0).max() < BRANCH_RAD and gap.min(axis=1).max() < BRANCH_RAD)


def told(kind, worlds, first, size, others):
    """Of every pair of regions with enough in common: junctions in common, places elsewhere in the
    own world, bits."""
    strange = [make_world(kind, KINDS[kind], first + 10_000 + k) for k in range(others)]
    trees = [cKDTree(other.xy) for other in strange]
    out = []
    for w in range(worlds):
        world = make_world(kind, KINDS[kind], first + w)
        home = cKDTree(world.xy)
        regions = scattered_regions(world, RUNS, size, Chance("calibration", first + w))
        for a, b in combinations(regions, 2):
            some = sorted(a & b)
            if len(some) < FEWEST:
                continue
            own = places_of(world, some, world, home) - 1
            hits = sum(map(partial(places_of, world, some), strange, trees))
            # As if half a place had been found in one world more.
            out.append((len(some), own, -np.log2((hits + 0.5) / (others + 1))))
    return np.array(out).reshape(-1, 3)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="seed of the first world")
    parser.add_argument("--size", type=int, default=35, help="junctions that a run sees")
    parser.add_argument("--others", type=int, default=1000, help="worlds of the kind looked at")
    options = parser.parse_args()
    most = np.log2(2 * (options.others + 1))
    need = needed_bits(2 * RUNS * (2 * RUNS - 1) // 2, DEFAULT_ROBUST)
    print(f"needed of eight runs: {need:.1f} bits; no more than {most:.1f} can be seen here")
    print("| world | pairs | again in its own world | < 4 bits | 4 to 8 | > 8 | as many as seen |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for kind in options.kinds:
        _, own, bits = told(kind, options.worlds, options.first, options.size, options.others).T
        once = bits[own == 0]
        cells = np.histogram(once, [-np.inf, 4.0, 8.0, np.inf])[0].tolist()
        cells += [int((once > most - 0.5).sum())]
        told_cells = " | ".join(map(str, cells))
        print(f"| {kind} | {len(own)} | {int((own > 0).sum())} | {told_cells} |", flush=True)


if __name__ == "__main__":
    main()
