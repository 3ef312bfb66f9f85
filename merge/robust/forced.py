"""Constrained alignment: the best placement that a "same" lock allows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...topology.columns import take
from ..locks import Lock
from .alignment import Candidate, Hypotheses, evaluate_all, ungrown_candidates
from .links import Seed, candidate_links, seeds
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

    candidates: best first. A lock without vertices takes the first. A lock of two vertices takes
    the first that matches them. If there is none, new hypotheses are tried: those of compatible
    corridors at both vertices, grown and as they are, and those of aligned branches, grown. The
    best with positive evidence is taken. Raises IndexError if a vertex does not exist.
    """
    if lock.at is None:
        return candidates[0] if candidates else None
    fitting = _matching(lock.at, candidates)
    if not fitting:
        by_branches = _branch_seeds(a, b, *lock.at)
        by_corridors = _corridor_seeds(a, b, *lock.at)
        tested = len(by_branches) + len(by_corridors)
        hypotheses = Hypotheses(a, b, [*by_corridors, *by_branches], tested)
        grown = next(evaluate_all([hypotheses], settings))
        # Growth gives up where too little agrees, but the lock rules out other placements.
        ungrown = (
            ungrown_candidates(hypotheses._replace(seeds=by_corridors)) if by_corridors else []
        )
        likely = [c for c in (*grown, *ungrown) if c.bits > 0]
        fitting = sorted(_matching(lock.at, likely), key=lambda c: -c.bits)
    return next(iter(fitting), None)


def _matching(at: tuple[int, int], candidates: Iterable[Candidate]) -> list[Candidate]:
    """The candidates that match two vertices."""
    return [c for c in candidates if np.any((c.a == at[0]) & (c.b == at[1]))]


def _corridor_seeds(a: Prepared, b: Prepared, va: int, vb: int) -> list[Seed]:
    """Hypotheses that match two vertices, and others at the far ends of compatible corridors."""
    links = candidate_links(a, b)
    tails = (a.tail[links.a_row] == va) & (b.tail[links.b_row] == vb)
    heads = (a.head[links.a_row] == va) & (b.head[links.b_row] == vb)
    links = take(links, tails | heads)
    return seeds(a, b, links, len(links))


def _branch_seeds(a: Prepared, b: Prepared, va: int, vb: int) -> list[Seed]:
    """Hypotheses of two vertices alone, with every rotation that aligns two branches."""
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
