"""Constrained alignment: the best placement that a "same" lock allows, whatever its evidence."""

from __future__ import annotations

import numpy as np

from ..locks import Lock
from .alignment import Candidate, best_of
from .links import Seed
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

    Without a vertex pair: the best candidate. With one: the best candidate that matches the two
    vertices, else the best match grown from them with any rotation that aligns a branch of one with
    a branch of the other. Raises IndexError if a vertex does not exist.
    """
    if lock.at is None:
        return candidates[0] if candidates else None
    va, vb = lock.at
    fitting = [c for c in candidates if np.any((c.a == va) & (c.b == vb))]
    if fitting:
        return fitting[0]
    turns = a.heading[va, : a.count[va], None] - b.heading[vb, : b.count[vb]]
    seeds = [
        Seed(
            np.array([va]),
            np.array([vb]),
            float(turn),
            complex(a.z[va] - np.exp(1j * turn) * b.z[vb]),
            0.0,
        )
        for turn in turns.reshape(-1).tolist()
    ]
    grown = best_of(a, b, seeds, tested=len(seeds), settings=settings)
    return next((c for c in grown if np.any((c.a == va) & (c.b == vb))), None)
