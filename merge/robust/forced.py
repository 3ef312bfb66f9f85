"""Constrained alignment: the best placement that a "same" lock allows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..locks import Lock
from .alignment import Candidate, as_sown, best_of_all
from .links import Links, Seed, candidate_links, seeds
from .prepare import Prepared
from .settings import RobustSettings


def forced_alignment(
    a: Prepared,
    b: Prepared,
    candidates: tuple[Candidate, ...],
    lock: Lock,
    settings: RobustSettings,
) -> Candidate | None:
    """The best alignment that satisfies a "same" lock; None if there is none.

    candidates: best first. Without a vertex pair: the first. With one: the first that matches the
    two vertices, else the best match with more evidence for it than against it that corridors at
    both suggest, as it is or grown, or that is grown from the two with any rotation that aligns a
    branch of one with a branch of the other. Raises IndexError if a vertex does not exist.
    """
    if lock.at is None:
        return candidates[0] if candidates else None
    fitting = _with(lock.at, candidates)
    if not fitting:
        turned, along = _turned(a, b, *lock.at), _along_corridors(a, b, *lock.at)
        tested = len(turned) + len(along)
        found = next(best_of_all([(a, b, [*along, *turned], tested)], settings))
        # Growth gives up where too little agrees, which is no reason to place the two elsewhere.
        sown = as_sown((a, b, along, tested)) if along else []
        likely = [c for c in (*found, *sown) if c.bits > 0]
        fitting = sorted(_with(lock.at, likely), key=lambda c: -c.bits)
    return next(iter(fitting), None)


def _with(at: tuple[int, int], candidates: Iterable[Candidate]) -> list[Candidate]:
    """The candidates that match two vertices."""
    return [c for c in candidates if np.any((c.a == at[0]) & (c.b == at[1]))]


def _along_corridors(a: Prepared, b: Prepared, va: int, vb: int) -> list[Seed]:
    """Hypotheses of the two vertices and others at the ends of like corridors."""
    links = candidate_links(a, b)
    tails = (a.tail[links.a_row] == va) & (b.tail[links.b_row] == vb)
    heads = (a.head[links.a_row] == va) & (b.head[links.b_row] == vb)
    mine = np.flatnonzero(tails | heads)
    here = Links(links.a_row[mine], links.b_row[mine], links.theta[mine], links.bits[mine])
    return seeds(a, b, here, len(here))


def _turned(a: Prepared, b: Prepared, va: int, vb: int) -> list[Seed]:
    """Hypotheses of the two vertices alone, with every rotation that aligns two of their
    branches."""
    turns = a.heading[va, : a.count[va], None] - b.heading[vb, : b.count[vb]]
    return [
        Seed(
            np.array([va]),
            np.array([vb]),
            float(turn),
            complex(a.z[va] - np.exp(1j * turn) * b.z[vb]),
            0.0,
        )
        for turn in turns.reshape(-1).tolist()
    ]
