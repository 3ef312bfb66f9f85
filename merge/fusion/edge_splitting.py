"""Splitting corridors at junctions that their own run missed.

A run that misses a junction maps one long corridor through it. Where another run knows the
junction, the long corridor becomes a member of the corridors between.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...topology.passes import NO_BRANCH
from .edges import CORRIDOR, Corridor, fuse_corridors


@dataclass(frozen=True, slots=True)
class PassageSettings:
    """When several corridors together are one."""

    junction_m: float = 0.3
    """Standard deviation of a corridor's length against the sum of its parts, per missed
    junction."""
    deepest: int = 4
    """Limit on junctions missed in one corridor."""


PASSAGE = PassageSettings()


def split_at_places(corridors: list[Corridor]) -> list[Corridor]:
    """Replace corridors through known places by the corridors between those, recognised by the
    branches at both ends and the length; the parts of one may be replaced in turn."""
    while len(replaced := _replaced_once(corridors)) < len(corridors):
        corridors = fuse_corridors(replaced)
    return corridors


def _replaced_once(corridors: Sequence[Corridor]) -> list[Corridor]:
    """One round, shortest corridors first; a corridor that became a part of another waits for the
    next round."""
    leaving = _by_branch(corridors)
    gone: set[int] = set()
    through: dict[int, list[Corridor]] = {}
    for number in sorted(range(len(corridors)), key=lambda k: (corridors[k].length, k)):
        chain = () if number in through else _chain(number, corridors, leaving)
        if not chain or gone & {*chain}:
            continue
        gone.add(number)
        for k in chain:
            through.setdefault(k, []).append(corridors[number])
    return [_driven_more(c, through.get(k, ())) for k, c in enumerate(corridors) if k not in gone]


def _driven_more(c: Corridor, longer: Sequence[Corridor]) -> Corridor:
    """The corridor, also driven by the runs of longer ones that it is a part of."""
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


def _by_branch(corridors: Sequence[Corridor]) -> Leaving:
    """The corridors at each place, in both directions."""
    out: dict[int, list[tuple[int, _Way]]] = {}
    for k, c in enumerate(corridors):
        out.setdefault(c.u, []).append((c.branch_u, _Way(k, c.v, c.branch_v)))
        out.setdefault(c.v, []).append((c.branch_v, _Way(k, c.u, c.branch_u)))
    return out


def _chain(number: int, corridors: Sequence[Corridor], leaving: Leaving) -> tuple[int, ...]:
    """Known corridors that together are this one: same first and last branch, same length.

    Only one corridor leaves by a branch, so that a shorter one by the same branch ends at a
    junction on the way. Of several chains the one nearest in length; () if there is none.
    """
    c = corridors[number]
    if NO_BRANCH in {c.branch_u, c.branch_v} or c.u == c.v:
        return ()
    best: tuple[float, tuple[int, ...]] = (np.inf, ())
    for chain in _chains(c, number, corridors, leaving):
        parts = [corridors[k] for k in chain]
        missed = (len(parts) - 1) * PASSAGE.junction_m**2
        sigma = float(np.sqrt(sum(p.sigma**2 for p in parts) + c.sigma**2 + missed))
        off = abs(sum(p.length for p in parts) - c.length)
        if off <= CORRIDOR.allowed_m(c.length, sigma):
            best = min(best, (off, chain))
    return best[1]


def _chains(
    c: Corridor, number: int, corridors: Sequence[Corridor], leaving: Leaving
) -> Iterator[tuple[int, ...]]:
    """All chains of corridors from one end of a corridor to the other, by its own first and last
    branch."""
    longest = 1.2 * c.length + 1.0
    stack: list[tuple[int, int | None, float, tuple[int, ...]]] = [(c.u, None, 0.0, ())]
    while stack:
        place, arrived, way, chain = stack.pop()
        for branch, step in leaving[place]:
            total = way + corridors[step.number].length
            onwards = branch == c.branch_u if arrived is None else branch != arrived
            if not onwards or step.number == number or step.number in chain or total > longest:
                continue
            longer = (*chain, step.number)
            if (step.place, step.branch) == (c.v, c.branch_v):
                if len(longer) > 1:
                    yield longer
            elif len(longer) <= PASSAGE.deepest:
                stack.append((step.place, step.branch, total, longer))
