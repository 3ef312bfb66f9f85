"""Calibration of the evidence in bits.

    python benchmarks/calibration.py [--pairs 100000] [--svg FILE] [--first SEED]

Pairs of maps without a common place: of different buildings, and of different parts of one
building, which is harder since its grid and its patterns repeat. For every number of bits t the
share of pairs with an alignment of at least t bits is compared with 2^-t, on which the threshold of
`--false-merge-rate` relies. Offices have copies: their bits are those of the second question (this
place or a copy of it?), for every alignment that is not explained by chance.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from observed import scattered_maps

from topobatch.merge.robust import DEFAULT_ROBUST, match, prepare
from topobatch.merge.robust.repetition import default_copies, sameness
from topobatch.simulation.worlds import make_world

COPIES = default_copies(DEFAULT_ROBUST)
WORLD_SIZE, MAP_SIZE, RUNS = 320, 28, 16
MOST_BITS = 20


def unrelated_pairs(kind, pairs, first):
    """Prepared pairs without a common place: half of one world, half of two, as far as it goes."""
    ready = []
    seed = first
    rng = np.random.default_rng(first)
    while pairs > 0:
        world = make_world(kind, WORLD_SIZE, seed)
        maps = [(prepare(m), seen) for m, seen in scattered_maps(world, RUNS, MAP_SIZE, seed)]
        own = [(a, b) for k, (a, sa) in enumerate(maps) for b, sb in maps[k + 1 :] if not sa & sb]
        others = [p for p, _ in ready]
        mixed = [(a, others[rng.integers(len(others))]) for a, _ in maps * 6 if others]
        yield from (own + mixed)[:pairs]
        pairs -= len(own) + len(mixed)
        ready = (ready + maps)[-8 * RUNS :]
        seed += 1


def bits_against_chance(a, b):
    """Bits of the best alignment that could be merged; minus infinity if there is none."""
    enough = (c for c in match(a, b, DEFAULT_ROBUST) if len(c) >= DEFAULT_ROBUST.min_matches)
    found = [c.counted_bits for c in enough]
    return max(found, default=-np.inf)


def bits_against_copies(a, b):
    """As above, of both questions the one answered worse, with the margin that verdicts use."""
    cases = [
        (a, b, c)
        for c in match(a, b, DEFAULT_ROBUST)
        if len(c) >= DEFAULT_ROBUST.min_matches and c.bits > 0
    ]
    found = [
        min(c.counted_bits, same.bits + DEFAULT_ROBUST.copy_margin_bits)
        for (_, _, c), same in zip(cases, sameness(cases, COPIES), strict=True)
    ]
    return max(found, default=-np.inf)


def table(bits):
    """{kind: (pairs,) bits} as rows (t, promise, share per kind)."""
    for t in range(MOST_BITS + 1):
        yield t, 2.0**-t, [np.mean(values >= t) for values in bits.values()]


def as_text(bits):
    """The table, and a plot of log10 rates: one column of marks per kind, `|` is the promise."""
    names = list(bits)
    head = "".join(f"{name + ' ' + format(len(bits[name]), ','):>20}" for name in names)
    lines = [f"bits    promise{head}   log10 rate, -6 ... 0"]
    for t, promise, shares in table(bits):
        bar = [" "] * 61
        for name, share in zip(names, shares, strict=True):
            if share > 0:
                bar[round(10 * np.log10(share)) + 60] = name[0]
        bar[max(round(10 * np.log10(promise)) + 60, 0)] = "|"
        cells = "".join(f"{share:20.6f}" for share in shares)
        lines.append(f"{t:4d} {promise:10.6f}{cells}   {''.join(bar)}")
    return "\n".join(lines)


def draw(bits, path):
    """The same as a picture: rates over bits, logarithmic."""
    figure = Figure(figsize=(7, 4.5))
    axes = figure.add_subplot(xlabel="bits of evidence", yscale="log", ylim=(1e-6, 1))
    at = np.arange(0, MOST_BITS, 0.25)
    axes.plot(at, 2.0**-at, "--", color="0.5", label="promise")
    for name, values in bits.items():
        rates = [np.mean(values >= t) or np.nan for t in at]
        axes.plot(at, rates, label=f"{name}, {len(values):,} pairs")
    axes.legend()
    figure.savefig(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=100_000, help="over all kinds of world")
    parser.add_argument("--first", type=int, default=0, help="seed of the first world")
    parser.add_argument("--svg", type=Path)
    options = parser.parse_args()
    asked = {
        "maze": (0.45, bits_against_chance),
        "organic": (0.45, bits_against_chance),
        "office": (0.1, bits_against_copies),
    }
    bits = {}
    for kind, (share, ask) in asked.items():
        count = round(options.pairs * share)
        found = [ask(a, b) for a, b in unrelated_pairs(kind, count, options.first)]
        bits[kind] = np.array(found)
    print(as_text(bits))
    if options.svg:
        draw(bits, options.svg)


if __name__ == "__main__":
    main()
