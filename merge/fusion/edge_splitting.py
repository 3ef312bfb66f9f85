"""Splitting corridors at junctions that their own run missed.

A run that misses a junction maps one long corridor through it. Where another run detected the
junction, the long corridor becomes a member of the corridors that it consists of.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...topology.passes import NO_BRANCH
from .edges import Corridor, allowed_m, fuse_corridors

DEEPEST = 4
"""Limit on junctions missed in one corridor, of the time to look for chains. Tried: 100, no
change."""


def split_at_places(corridors: list[Corridor]) -> list[Corridor]:
    """Replace corridors through known places by chains of corridors between these, with the same
    branches at both ends and the same length. Corridors of a chain may be replaced in turn."""
    while len(replaced := _replaced_once(corridors)) < len(corridors):
        corridors = fuse_corridors(replaced)
    return corridors


def _replaced_once(corridors: Sequence[Corridor]) -> list[Corridor]:
    """One round, shortest corridors first. New parts of others wait for the next round."""
    ways_from = _leaving(corridors)
    replaced: set[int] = set()
    longer: dict[int, list[Corridor]] = {}
    for row in sorted(range(len(corridors)), key=lambda k: (corridors[k].length, k)):
        parts = () if row in longer else _chain(row, corridors, ways_from)
        if not parts or replaced & {*parts}:
            continue
        replaced.add(row)
        for k in parts:
            longer.setdefault(k, []).append(corridors[row])
    return [
        _driven_more(c, longer.get(k, ())) for k, c in enumerate(corridors) if k not in replaced
    ]


def _driven_more(c: Corridor, longer: Sequence[Corridor]) -> Corridor:
    """The corridor, with the runs of the longer ones that it is a part of."""
    if not longer:
        return c
    members = tuple(sorted({*c.members, *(m for other in longer for m in other.members)}))
    return replace(
        c, traversals=c.traversals + sum(other.traversals for other in longer), members=members
    )


@dataclass(frozen=True, slots=True)
class _Way:
    """A corridor as it leaves a place: its index, and the place and branch at its other end."""

    number: int
    place: int
    branch: int


Leaving = Mapping[int, Sequence[tuple[int, _Way]]]
"""For every place its corridors: (branch, way)."""


def _leaving(corridors: Sequence[Corridor]) -> Leaving:
    """The corridors that leave each place, in both directions."""
    ways: dict[int, list[tuple[int, _Way]]] = {}
    for k, c in enumerate(corridors):
        ways.setdefault(c.u, []).append((c.branch_u, _Way(k, c.v, c.branch_v)))
        ways.setdefault(c.v, []).append((c.branch_v, _Way(k, c.u, c.branch_u)))
    return ways


def _chain(row: int, corridors: Sequence[Corridor], ways_from: Leaving) -> tuple[int, ...]:
    """The chain of other corridors with the first and last branch and the length of this one.

    Only one corridor leaves by a branch, so that a shorter one by the same branch ends at a
    junction on the way. Of several chains the one nearest in length; () if there is none.
    """
    c = corridors[row]
    if NO_BRANCH in {c.branch_u, c.branch_v} or c.u == c.v:
        return ()
    best: tuple[float, tuple[int, ...]] = (np.inf, ())
    for chain in _chains(c, row, corridors, ways_from):
        parts = [corridors[k] for k in chain]
        sigma = float(np.sqrt(sum(p.sigma**2 for p in parts) + c.sigma**2))
        difference = abs(sum(p.length for p in parts) - c.length)
        if difference <= allowed_m(c.length, sigma):
            best = min(best, (difference, chain))
    return best[1]


def _chains(
    c: Corridor, row: int, corridors: Sequence[Corridor], ways_from: Leaving
) -> Iterator[tuple[int, ...]]:
    """Chains of two or more other corridors between the ends of corridor c, number `row`, by its
    branches there: through at most `DEEPEST` places, and little longer than c."""
    longest = c.length + allowed_m(c.length, 2 * c.sigma)  # of parts as uncertain as it
    stack: list[tuple[int, int | None, float, tuple[int, ...]]] = [(c.u, None, 0.0, ())]
    while stack:
        place, arrived, length, chain = stack.pop()
        for branch, step in ways_from[place]:
            total = length + corridors[step.number].length
            continues = branch == c.branch_u if arrived is None else branch != arrived
            if not continues or step.number == row or step.number in chain or total > longest:
                continue
            extended = (*chain, step.number)
            if (step.place, step.branch) == (c.v, c.branch_v):
                if len(extended) > 1:
                    yield extended
            elif len(extended) <= DEEPEST:
                stack.append((step.place, step.branch, total, extended))
