"""Trusted merging against the clock: python benchmarks/merging.py [--pairs N] [--overlap S]

Pairs of maps of one random maze (`mazes.py`), 50 to 800 junctions each, the second in a frame of
its own. Per pair, after preparation: candidate links, growth, evidence, verdict. Beside it, on the
same maps in the same run, Hough voting over four rotations and all translations. Best process CPU
time of several calls, one thread; unrelated pairs are maps of two different mazes.
"""

from __future__ import annotations

import argparse

import numpy as np
from mazes import Noise
from paper import cpu_ms, pair_of_maps, right

from topobatch.merge.result import Verdict
from topobatch.merge.robust import DEFAULT_ROBUST, match, prepare
from topobatch.merge.robust.repetition import default_copies
from topobatch.merge.robust.verdict import assess, threshold_for

SIZES = (50, 126, 300, 800)
CELL_M = 0.5


def hough(xy_a, xy_b):
    """The T_a_b of four right angles and all translations that most pairs of junctions vote for."""
    best = (0, None)
    for turn in np.arange(4) * np.pi / 2:
        c, s = np.cos(turn), np.sin(turn)
        shift = xy_a[:, None] - (xy_b @ np.array([[c, s], [-s, c]]))[None]
        shift = shift.reshape(-1, 2)
        cell = np.floor(shift / CELL_M).astype(np.int64)
        cell -= cell.min(axis=0)
        wide = int(cell[:, 1].max()) + 2
        votes = np.bincount(cell[:, 0] * wide + cell[:, 1])
        # A peak may straddle a border: every cell takes its right and upper neighbours' votes, too.
        total = votes.copy()
        for step in (1, wide, wide + 1):
            total[:-step] += votes[step:]
        top = int(total.argmax())
        if total[top] > best[0]:
            near = ((cell - np.array([top // wide, top % wide])) <= 1).all(axis=1)
            near &= (cell >= np.array([top // wide, top % wide])).all(axis=1)
            best = (int(total[top]), np.append(shift[near].mean(axis=0), turn))
    return best[1]


def verdict(a, b, threshold):
    """What `decide` does for one pair, preparation and self-match aside."""
    return assess(a, b, match(a, b, DEFAULT_ROBUST), threshold)


def rows(pairs, overlap):
    """Per size: ms of preparation, of a related pair, of an unrelated one, of Hough voting; how
    many pairs each got right; how many unrelated pairs were merged."""
    threshold = threshold_for(1, 1, default_copies(DEFAULT_ROBUST), DEFAULT_ROBUST)
    for size in SIZES:
        maps = [pair_of_maps(size, overlap, seed, Noise()) for seed in range(pairs)]
        ready = [(prepare(a), prepare(b)) for a, b, _, _ in maps]
        made = np.mean([cpu_ms(lambda a=a: prepare(a), budget_ms=50) for a, _, _, _ in maps])
        ours = [cpu_ms(lambda a=a, b=b: verdict(a, b, threshold), budget_ms=60) for a, b in ready]
        other = [(a, ready[k - 1][1]) for k, (a, _) in enumerate(ready)]
        apart = [cpu_ms(lambda a=a, b=b: verdict(a, b, threshold), budget_ms=60) for a, b in other]
        votes = [cpu_ms(lambda a=a, b=b: hough(a.xy, b.xy), budget_ms=60) for a, b, _, _ in maps]
        good = good_votes = 0
        for (a, b, onto, from_), (pa, pb) in zip(maps, ready, strict=True):
            view = verdict(pa, pb, threshold)
            merged = view.verdict is Verdict.MERGED
            good += merged and right(view.best.transform, onto, from_)
            good_votes += right(hough(a.xy, b.xy), onto, from_)
        wrong = sum(verdict(a, b, threshold).verdict is Verdict.MERGED for a, b in other)
        times = (made, np.mean(ours), np.mean(apart), np.mean(votes))
        yield size, times, good, good_votes, wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--overlap", type=float, default=0.3)
    options = parser.parse_args()
    print(f"{options.pairs} pairs per size, {options.overlap:.0%} overlap; ms, one thread")
    print(
        "junctions  prepare/map   pair  unrelated  Hough  merged right  Hough right  false merges"
    )
    for size, (made, ours, apart, votes), good, good_votes, wrong in rows(
        options.pairs, options.overlap
    ):
        print(
            f"{size:9d} {made:12.2f} {ours:6.2f} {apart:10.2f} {votes:6.2f}"
            f" {good:8d} of {options.pairs} {good_votes:7d} of {options.pairs} {wrong:8d}"
        )


if __name__ == "__main__":
    main()
