"""Locks applied to the verdicts of a method that judges every pair by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ...topology.errors import UsageError
from ...topology.se2 import apply
from ...topology.topomap import TopoMap
from ..locks import Lock, lock_table
from ..result import Alignment, PairVerdict, Verdict

NEAR_M = 0.75
"""Vertices this close under a transform count for it if only one pair is given."""


def honour(
    verdicts: Sequence[PairVerdict],
    locks: Sequence[Lock],
    forced: Callable[[Lock], Alignment | None],
) -> tuple[PairVerdict, ...]:
    """The verdicts with every lock applied.

    "same" pairs are accepted with the alignment that `forced` finds for them, "never" pairs are
    not; and no chain of accepted pairs joins two runs that are locked apart: its weakest match is
    refused. Locks of runs without a verdict are ignored.
    """
    table = lock_table(locks)
    decided = [_locked(v, table.get((v.a, v.b)), forced) for v in verdicts]
    return _kept_apart(decided, table)


def _locked(
    verdict: PairVerdict, lock: Lock | None, forced: Callable[[Lock], Alignment | None]
) -> PairVerdict:
    if lock is None:
        return verdict
    if lock.decision == "never":
        return replace(
            verdict,
            verdict=Verdict.UNRELATED,
            accepted=False,
            accepted_by=None,
            locked="never",
            reason=f"locked apart; without the lock: {verdict.reason}",
        )
    best = forced(lock)
    if best is None:
        reason = "locked together, but nothing says how: name a junction of each run in the lock"
        return replace(verdict, locked="same", accepted=False, accepted_by=None, reason=reason)
    return replace(
        verdict,
        verdict=Verdict.MERGED,
        accepted=True,
        accepted_by="lock",
        locked="same",
        best=best,
        evidence_bits=best.evidence_bits,
        reason=f"locked together; without the lock: {verdict.reason}",
    )


def _kept_apart(
    verdicts: Sequence[PairVerdict], table: dict[tuple[str, str], Lock]
) -> tuple[PairVerdict, ...]:
    """Verdicts joined strongest first, refusing those that bring together runs that are locked
    apart."""
    never = [pair for pair, lock in table.items() if lock.decision == "never"]
    group = {run: {run} for v in verdicts for run in (v.a, v.b)}
    out = {(v.a, v.b): v for v in verdicts}
    order = sorted(
        (v for v in verdicts if v.accepted),
        key=lambda v: (v.locked != "same", -v.evidence_bits, v.a, v.b),
    )
    for v in order:
        joined = group[v.a] | group[v.b]
        clash = next(((a, b) for a, b in never if a in joined and b in joined), None)
        if clash is None:
            for run in joined:
                group[run] = joined
            continue
        reason = (
            f"{v.reason}; refused: {clash[0]} and {clash[1]} would meet, which are locked apart"
        )
        out[v.a, v.b] = replace(v, accepted=False, accepted_by=None, reason=reason)
    return tuple(out[v.a, v.b] for v in verdicts)


def aligned_at(a: TopoMap, b: TopoMap, at: tuple[int, int]) -> Alignment | None:
    """The alignment that puts one junction of b on one of a with branches aligned.

    Of all rotations that align a branch of one with a branch of the other, the one that brings most
    other vertices together. None if a junction has no branches. Raises UsageError if one does not
    exist.
    """
    for m, vertex in zip((a, b), at, strict=True):
        if vertex >= len(m):
            raise UsageError(
                f"the lock of {a.run!r} and {b.run!r} names junction {vertex} of {m.run!r}, which "
                f"has {len(m)}: lock by the numbers in its map document"
            )
    u, v = at
    turns = (a.branches[u][:, None] - b.branches[v]).reshape(-1)
    if len(turns) == 0:
        return None
    tree = cKDTree(a.xy)
    turned = np.column_stack([np.zeros((len(turns), 2)), turns])
    transforms = np.column_stack([a.xy[u] - apply(turned, b.xy[v]), turns])
    near = [np.count_nonzero(tree.query(apply(T, b.xy))[0] <= NEAR_M) for T in transforms]
    best = transforms[int(np.argmax(near))]
    return Alignment(best, 0.0, np.array([[u, v]]), 0.0)
