"""Locks applied to the verdicts of a method that judges every pair by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from ..locks import Lock, Names
from ..result import Alignment, PairVerdict, Verdict


def with_locks(
    verdicts: Sequence[PairVerdict],
    table: Mapping[Names, Lock],
    forced: Callable[[Lock], Alignment | None],
) -> tuple[PairVerdict, ...]:
    """The verdicts with every lock applied.

    "same" pairs are accepted with the alignment that `forced` finds for them, "never" pairs are
    not; and no chain of accepted pairs joins two runs that are locked apart: its weakest match is
    refused. table: the locks by pair.
    """
    decided = [_locked(v, table.get((v.a, v.b)), forced) for v in verdicts]
    return _kept_apart(decided, table)


def _locked(
    verdict: PairVerdict, lock: Lock | None, forced: Callable[[Lock], Alignment | None]
) -> PairVerdict:
    """The verdict on a pair, by its lock if there is one."""
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
        reason = "locked together, but no match of the two honours the lock"
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
    verdicts: Sequence[PairVerdict], table: Mapping[Names, Lock]
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
