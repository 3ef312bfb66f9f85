"""Fleets: python benchmarks/fleet.py [--sizes 200,400,1000] [--recall N] [--beyond N] [--index N]

Maps of some 50 junctions are made without logs (`observed.py`): ten runs in each of many sites,
which are mazes, offices, organic ways and city blocks in turn. For every number of maps, CPU
seconds of one process: preparing the maps, the index, matching the pairs that have a chance, all of
a merge up to its document and the memory until then, what of that is none of these (rest); the
same merge with a cache that knows all of it, with nothing new, with one more run of the site in
the middle, and of an office, which may tell anew how copies differ; a plain loop over all pairs,
and all of them by the matcher of many pairs at a time, both measured on a sample.
What was joined is judged by the truth: false are runs of different sites in one component; found
are the pairs of runs that share five junctions or more. Exponents are those between neighbouring
rows.

--recall: merges so many maps with and without the index and compares what is accepted and joined.
--beyond: counts, of so many maps, the pairs that chance does not explain (mostly copies) and that
the index leaves out; they count in how sure a pair must be of not being a copy.
--index: looks only, for so many maps, how many of their pairs the index lets through, and how fast.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections import deque
from itertools import pairwise
from pathlib import Path

import numpy as np
from observed import observed_map, scattered_regions

from topobatch.merge.document import write_merged
from topobatch.merge.kept import Kept
from topobatch.merge.merging import merge_maps
from topobatch.merge.result import pairs_of
from topobatch.merge.robust import DEFAULT_ROBUST, Means, era_of, match, prepare, screening
from topobatch.merge.robust.alignment import match_all
from topobatch.merge.robust.pairing import tile_order
from topobatch.merge.robust.screening import pairs_to_match
from topobatch.merge.robust.verdict import beyond_chance_bits, needed_bits
from topobatch.simulation.chance import Chance
from topobatch.simulation.worlds import make_world

KINDS = ("maze", "office", "organic", "city")
SAMPLE = 2000
FEWEST_SHARED = 5


def fleet_of(count, *, per_site=10, world=200, size=50, first=0):
    """`count` maps of runs in sites of four kinds, each with (site, world vertices that it saw).

    A site is a world of so many junctions; its runs drove parts of about `size` of them.
    """
    out = []
    for site in range(-(-count // per_site)):
        seed = first + site
        building = make_world(KINDS[site % len(KINDS)], world, seed)
        rng = np.random.default_rng(seed)
        regions = scattered_regions(building, per_site, size, Chance("fleet", seed))
        for k, region in enumerate(regions):
            topomap = observed_map(building, region, rng, f"s{site:04d}-{k:02d}")
            out.append((topomap, (site, frozenset(topomap.info["truth"]))))
    return out[:count]


class Clock:
    """CPU seconds since it was last asked."""

    def __init__(self):
        self.at = time.process_time()

    def lap(self):
        now = time.process_time()
        spent, self.at = now - self.at, now
        return spent


def joined_pairs(result):
    """Pairs of runs in one component."""
    homes = [sorted(c.poses) for c in result.components]
    return {(a, b) for runs in homes for k, a in enumerate(runs) for b in runs[k + 1 :]}


def judged(result, truth):
    """(false, found, overlapping) pairs of runs."""
    joined = joined_pairs(result)
    false = sum(truth[a][0] != truth[b][0] for a, b in joined)
    runs = sorted(truth)
    by_site = {}
    for run in runs:
        by_site.setdefault(truth[run][0], []).append(run)
    over = {
        (a, b)
        for own in by_site.values()
        for k, a in enumerate(own)
        for b in own[k + 1 :]
        if len(truth[a][1] & truth[b][1]) >= FEWEST_SHARED
    }
    return false, len(over & joined), len(over)


def office_in_the_middle(count, per_site=10):
    """The number of a run of an office."""
    sites = np.arange(KINDS.index("office"), max(count // per_site, 2), len(KINDS))
    return int(sites[len(sites) // 2]) * per_site + 1


def one_size(count, first):
    """A row of the table."""
    fleet = fleet_of(count + 2, first=first)
    maps = [topomap for topomap, _ in fleet]
    truth = {topomap.run: known for topomap, known in fleet}
    late = maps.pop(len(maps) // 2)  # the run that comes last shares places with others
    office = maps.pop(office_in_the_middle(count))
    row = {"maps": count, "junctions": round(float(np.mean([len(m) for m in maps])))}
    clock = Clock()
    ready = [prepare(m) for m in maps]
    row["prepare"] = clock.lap()
    wanted = pairs_to_match(ready, DEFAULT_ROBUST)
    row["index"] = clock.lap()
    row["chance"] = len(wanted) / pairs_of(count)
    likely = ((ready[i], ready[j]) for i, j in wanted[tile_order(wanted)].tolist())
    deque(match_all(likely, DEFAULT_ROBUST), maxlen=0)
    row["match"] = clock.lap()
    rng = np.random.default_rng(first)
    pairs = np.sort(rng.integers(count, size=(2 * SAMPLE, 2)), axis=1)
    pairs = pairs[pairs[:, 0] < pairs[:, 1]][:SAMPLE]
    clock.lap()
    for i, j in pairs.tolist():
        match(ready[i], ready[j], DEFAULT_ROBUST)
    row["loop"] = clock.lap() / len(pairs) * pairs_of(count)
    some = ((ready[i], ready[j]) for i, j in pairs.tolist())
    deque(match_all(some, DEFAULT_ROBUST), maxlen=0)
    row["all"] = clock.lap() / len(pairs) * pairs_of(count)
    del ready
    with tempfile.TemporaryDirectory() as folder:
        cache, path = Path(folder) / "kept.sqlite", Path(folder) / "merged.json"
        kept = Kept(cache, era_of(DEFAULT_ROBUST))
        clock.lap()
        result = merge_maps(maps, means=Means(kept=kept))
        kept.flush()
        write_merged(path, result)
        row["merge"] = clock.lap()
        row["peak MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        row["rest"] = row["merge"] - row["prepare"] - row["index"] - row["match"]
        row["MB"] = path.stat().st_size / 1e6
        row["cache MB"] = cache.stat().st_size / 1e6
        for name, new in (("nothing", []), ("one more", [late]), ("office", [office])):
            clock.lap()
            kept = Kept(cache, era_of(DEFAULT_ROBUST))
            more = merge_maps([*maps, *new], means=Means(kept=kept))
            kept.flush()
            write_merged(path, more)
            row[name] = clock.lap()
    row["false"], row["found"], row["overlap"] = judged(
        result, {run: known for run, known in truth.items() if run not in (late.run, office.run)}
    )
    return row


def recall(count, first):
    """What merging with the index finds of what merging all pairs does."""
    maps = [topomap for topomap, _ in fleet_of(count, first=first)]
    screened = merge_maps(maps)
    usual = screening.MOST_PAIRS
    screening.MOST_PAIRS = pairs_of(count)
    try:
        clock = Clock()
        whole = merge_maps(maps)
        spent = clock.lap()
    finally:
        screening.MOST_PAIRS = usual
    accepted = [{(v.a, v.b) for v in r.verdicts if v.accepted} for r in (whole, screened)]
    joined = [joined_pairs(r) for r in (whole, screened)]
    print(f"{count} maps, {pairs_of(count):,} pairs; all of them in {spent:.0f} s")
    for name, (all_pairs, some) in (("accepted", accepted), ("joined", joined)):
        share = len(all_pairs & some) / max(len(all_pairs), 1)
        print(
            f"{name}: {len(all_pairs)} by all pairs, of which {len(all_pairs & some)} with the "
            f"index ({share:.4f}); {len(some - all_pairs)} with the index alone"
        )


def index_only(count, first):
    """How many pairs have a chance, and what it takes to know."""
    ready = [prepare(topomap) for topomap, _ in fleet_of(count, first=first)]
    clock = Clock()
    wanted = pairs_to_match(ready, DEFAULT_ROBUST)
    spent = clock.lap()
    pairs = pairs_of(count)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    share = len(wanted) / pairs
    print(
        f"{count} maps, {pairs:,} pairs: {len(wanted):,} have a chance ({share:.4f}); "
        f"{spent:.1f} s, {spent / pairs * 1e6:.1f} us a pair; peak {peak:.2f} GB with all maps"
    )


def beyond(count, first):
    """How many of the pairs beyond chance the index gives none."""
    ready = [prepare(topomap) for topomap, _ in fleet_of(count, first=first)]
    need = needed_bits(pairs_of(count), DEFAULT_ROBUST)
    likely = screening.likely_pairs(ready, screening.SHARE * need)
    seen = {(i, j) for i, j in likely.tolist()}
    found = [
        (i, j)
        for i, a in enumerate(ready)
        for j, b in enumerate(ready[i + 1 :], i + 1)
        if beyond_chance_bits(match(a, b, DEFAULT_ROBUST), DEFAULT_ROBUST) >= need
    ]
    lost = sum(pair not in seen for pair in found)
    print(f"{count} maps: {len(found)} pairs beyond chance, {lost} of which the index gives none")


SECONDS = (
    "prepare",
    "index",
    "match",
    "rest",
    "merge",
    "nothing",
    "one more",
    "office",
    "loop",
    "all",
)


def table(sizes, first):
    """Rows by size, then the exponents between them."""
    rows = []
    for size in sizes:
        rows.append(one_size(size, first))
        row = rows[-1]
        if len(rows) == 1:
            print(" ".join(f"{name:>9}" for name in row))
        print(" ".join(f"{v:9.3f}" if isinstance(v, float) else f"{v:9d}" for v in row.values()))
    for before, after in pairwise(rows):
        step = np.log(after["maps"] / before["maps"])
        told = (f"{n} {np.log(after[n] / before[n]) / step:.2f}" for n in SECONDS)
        print(f"exponents {before['maps']} to {after['maps']}: {', '.join(told)}")
    for row in rows:
        some = row["index"] + row["match"]
        print(
            f"{row['maps']}: the loop takes {row['loop'] / some:.1f} times as long as index and "
            f"matches, all pairs at once {row['all'] / some:.1f} times; "
            f"one more run {row['one more'] / row['merge']:.3f} of a merge, of an office "
            f"{row['office'] / row['merge']:.3f}, "
            f"{row['one more'] / (row['loop'] + row['merge'] - some):.3f} of one by the loop"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="200,400,1000")
    parser.add_argument("--recall", type=int, default=200)
    parser.add_argument("--index", type=int, default=0)
    parser.add_argument("--beyond", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    if options.sizes:
        table([int(size) for size in options.sizes.split(",")], options.first)
    if options.recall:
        recall(options.recall, options.first)
    if options.beyond:
        beyond(options.beyond, options.first)
    if options.index:
        index_only(options.index, options.first)


if __name__ == "__main__":
    main()
