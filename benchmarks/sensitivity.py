"""Sensitivity of robust merging to its settings.

    python benchmarks/sensitivity.py [--only NAME ...]

Every number is divided and multiplied by FACTOR in turn, and worlds of all kinds (`aliasing.py`)
are merged, in one batch and as pairs of runs of one world. Shown: by kind of world the change in
the number of pairs with common junctions that end in one component; pairs merged at a false
placement; and CPU time. Numbers with no effect in either row are not determined by these worlds.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import fields
from itertools import combinations

import numpy as np
from aliasing import added, batch, score

from topobatch.merge.robust import DEFAULT_ROBUST, conflicts, links, repetition
from topobatch.merge.robust.repetition import COPIES
from topobatch.merge.robust.settings import MATCH

FACTOR = 1.5
WORLDS = {"tiles": 8, "office": 6, "rows": 2, "maze": 5, "organic": 2, "city": 2}


def numbers():
    """(settings, name) of everything that may be changed by a factor."""
    for settings in (DEFAULT_ROBUST, MATCH, COPIES):
        for field in fields(settings):
            if isinstance(getattr(settings, field.name), (int, float)):
                yield settings, field.name


def instead(settings, name, factor):
    """A number so many times as large; whole numbers differ by one at least, shares end at one."""
    value = getattr(settings, name)
    if isinstance(value, int):
        return max(round(value * factor), value + 1) if factor > 1 else round(value * factor)
    return min(value * factor, 1.0) if name.endswith("share") else value * factor


def put(settings, name, value):
    """Change a number in place, and what was worked out of it when modules were read."""
    object.__setattr__(settings, name, value)
    conflicts.BESIDE_M = float(np.hypot(MATCH.clear_m / 2, MATCH.gate_m))
    repetition.WORST_NATS = MATCH.most_bits * np.log(2)
    links.COS_TURN = float(np.cos(MATCH.turn_rad))


def parts(kind, worlds, first):
    """All maps of some worlds as one batch, and any two of one world."""
    maps = batch(kind, worlds, first)
    two = combinations(maps, 2)
    return [maps, *([a, b] for a, b in two if a.info["world"] == b.info["world"])]


def judged(batches):
    """Right and wrong pairs of some batches by kind, and seconds of the processor."""
    start = time.process_time()
    scores = {kind: added(map(score, parts)) for kind, parts in batches.items()}
    spent = time.process_time() - start
    right = {kind: int(found[0].sum()) for kind, found in scores.items()}
    return right, sum(found[2] for found in scores.values()), spent


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0, help="seed of the first world")
    parser.add_argument("--only", nargs="*", help="names of numbers")
    options = parser.parse_args()
    batches = {kind: parts(kind, count, options.first) for kind, count in WORLDS.items()}
    right, wrong, spent = judged(batches)
    told = ", ".join(f"{kind} {count}" for kind, count in right.items())
    print(f"As it stands: right {told}; wrong {wrong}; {spent:.1f} s.\n")
    print(f"| number | value | instead | {' | '.join(right)} | wrong | time |")
    print(f"| --- | --- | --- |{' --- |' * len(right)} --- | --- |")
    for settings, name in numbers():
        if options.only and name not in options.only:
            continue
        value = getattr(settings, name)
        for factor in (1 / FACTOR, FACTOR):
            new = instead(settings, name, factor)
            put(settings, name, new)
            found, false, time_s = judged(batches)
            put(settings, name, value)
            more = {kind: count - right[kind] for kind, count in found.items()}
            cells = " | ".join(f"{count:+d}" if count else "" for count in more.values())
            print(
                f"| {name} | {value:g} | {new:g} | {cells} | {false or ''} | "
                f"{time_s / spent - 1:+.0%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
