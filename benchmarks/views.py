"""Evidence of views between maps of different buildings.

    python benchmarks/views.py WORKSPACE [WORKSPACE ...]

Each workspace holds the maps of one building, with their views. Maps of different workspaces are
matched by views alone; of every pair the placement with the most evidence against chance counts.
Evidence of b bits should be reached by no more than a share of 2^-b. Offices and rows of one
generator are copies of each other: they are to be given as one building.

Large batches are screened by descriptors of views: of the pairs of one building it prints how many
are among the maps that look most alike to one of the two, by their number.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np

from topobatch.merge.robust.screening import similarity
from topobatch.merge.robust.view_evidence import (
    JUDGE_PAIRS,
    overlaps,
    refine,
    repeats,
    revisits,
    view_evidence,
)
from topobatch.merge.robust.view_search import Picture, pictured, placements
from topobatch.topology.arrays import IntArray
from topobatch.topology.document import read_map
from topobatch.topology.se2 import compose

BITS = (0, 1, 2, 3, 4, 6, 8, 10)
PARTNERS = (5, 10, 20, 50, 100)


def pictures(workspace: Path) -> list[Picture]:
    """The views of all maps of a workspace."""
    maps = map(read_map, sorted((workspace / "maps").glob("*.json")))
    return [pictured(m.views) for m in maps if len(m.views)]


def most_bits(a: Picture, b: Picture) -> float:
    """The most evidence against chance of all placements that views propose [bits]."""
    placed = [compose(T, b.pose) for T, _ in refine(a, b, placements(a, b))]
    found = overlaps(a, b, placed, JUDGE_PAIRS)
    revisit_z = np.concatenate([revisits(a.views), revisits(b.views)])
    repeats_of_both = repeats(a.views), repeats(b.views)
    totals = [-np.inf]
    for overlap in found:
        others = [other for other in found if other is not overlap]
        totals.append(view_evidence(overlap, others, repeats_of_both, revisit_z).total)
    return max(totals)


def across(buildings: list[list[Picture]]) -> Iterator[float]:
    """Of every pair of maps of two buildings."""
    for one, two in combinations(buildings, 2):
        for a in one:
            for b in two:
                yield most_bits(a, b)


def ranks(buildings: list[list[Picture]]) -> IntArray:
    """Of every pair of maps of one building: the rank of one among all maps by how much they look
    like the other, the lower of both."""
    score = similarity([a.views for building in buildings for a in building])
    rank = np.argsort(np.argsort(-score, axis=1), axis=1) + 1
    of = np.arange(len(buildings)).repeat([len(building) for building in buildings])
    i, j = np.nonzero(np.triu(of[:, None] == of, 1))
    return np.minimum(rank[i, j], rank[j, i])


def main() -> None:
    """Print the shares of pairs."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    command.add_argument("workspaces", type=Path, nargs="+")
    buildings = [pictures(workspace) for workspace in command.parse_args().workspaces]
    rank = ranks(buildings)
    shares = ", ".join(f"{most}: {np.sum(rank <= most)}" for most in PARTNERS)
    print(f"{len(rank)} pairs of one building, among the most similar {shares}")
    found = np.array(list(across(buildings)))
    print(f"{len(found)} pairs; the most is {found.max(initial=-np.inf):.1f} bits")
    for bits in BITS:
        print(f"above {bits:2} bits  {np.mean(found > bits):.4f}   at most {0.5**bits:.4f}")


if __name__ == "__main__":
    main()
