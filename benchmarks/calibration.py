"""Is a bit a bit? python benchmarks/calibration.py [--pairs 100000] [--svg FILE] [--first SEED]

Pairs of maps that share no place: of different buildings, and of different parts of one building,
which is harder, since its grid and its habits repeat. For every number of bits t the share of pairs
that offer an alignment with t bits or more, beside the promise 2^-t that the threshold of
`--false-merge-rate` relies on. Offices repeat themselves: there the bits are those of the second
question ("this place, or a copy of it?"), asked of every alignment that chance does not explain.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from observed import scattered_maps

from topobatch.merge.robust import DEFAULT_ROBUST, match, prepare
from topobatch.merge.robust.repetition import default_copies, sameness
from topobatch.merge.robust.verdict import counted_bits
from topobatch.simulation import make_world

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
    found = [counted_bits(c) for c in enough]
    return max(found, default=-np.inf)


def bits_against_copies(a, b):
    """As above, of both questions the one answered worse, with the margin that verdicts use."""
    found = [
        min(counted_bits(c), sameness(a, b, c, COPIES).bits + DEFAULT_ROBUST.copy_margin_bits)
        for c in match(a, b, DEFAULT_ROBUST)
        if len(c) >= DEFAULT_ROBUST.min_matches and c.bits > 0
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


def as_svg(bits):
    """The same as a picture: rates over bits, logarithmic."""
    wide, high, left, top = 640, 420, 60, 20
    colours = ["#1f77b4", "#2ca02c", "#d62728"]

    def at(t, rate):
        x = left + (wide - left - 20) * t / MOST_BITS
        return x, top + (high - top - 50) * -np.log10(rate) / 6

    def line(points, colour, dash=""):
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="2" {dash}/>'

    parts = [line([at(t, 2.0**-t) for t in range(MOST_BITS)], "#888", 'stroke-dasharray="6 4"')]
    for k, (name, values) in enumerate(bits.items()):
        rates = [(t, np.mean(values >= t)) for t in np.arange(0, MOST_BITS, 0.25)]
        parts.append(line([at(t, r) for t, r in rates if r > 0], colours[k]))
        parts.append(
            f'<text x="{wide - 200}" y="{top + 20 + 18 * k}" fill="{colours[k]}">{name}, '
            f"{len(values):,} pairs</text>"
        )
    parts.append(f'<text x="{wide - 200}" y="{top + 74}" fill="#888">promise</text>')
    for power in range(7):
        x, y = at(0, 10.0**-power)
        parts.append(f'<text x="{x - 50:.0f}" y="{y + 4:.0f}">1e-{power}</text>')
    for t in range(0, MOST_BITS + 1, 4):
        x, _ = at(t, 1.0)
        parts.append(f'<text x="{x - 6:.0f}" y="{high - 30}">{t}</text>')
    parts.append(f'<text x="{wide / 2 - 60:.0f}" y="{high - 8}">bits of evidence</text>')
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide}" height="{high}" '
        f'font-family="sans-serif" font-size="13">\n<rect width="100%" height="100%" '
        f'fill="white"/>\n{body}\n</svg>\n'
    )


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
        options.svg.write_text(as_svg(bits))


if __name__ == "__main__":
    main()
