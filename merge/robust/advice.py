"""Advice for an ambiguous pair: which corridor to drive next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.passes import NO_BRANCH
from ...topology.se2 import wrap
from .alignment import Candidate
from .prepare import Prepared
from .verdict import Assessment


def advice(a: Prepared, b: Prepared, assessment: Assessment) -> str | None:
    """A sentence that names a corridor to drive: one that leaves a matched junction by a branch
    seen by both runs and driven by only one.

    Corridors at junctions that the runner-up matches differently are preferred, because they can
    refute it. None without a placement.
    """
    best = assessment.best
    if best is None:
        return None
    options = [
        *_driven_by_one(a, b, best.a, best.b, best.transform[2]),
        *_driven_by_one(b, a, best.b, best.a, -best.transform[2]),
    ]
    if not options:
        return (
            f"record {a.run} or {b.run} again, further along the edge of what both have seen: "
            "every corridor they share has been driven by both"
        )
    blind = _partners_of(assessment.runner_up)
    o = max(options, key=lambda o: (_refutes(o, blind, a), o.length, -o.other_vertex))
    return (
        f"record with {o.other.run}'s robot the corridor that {o.known.run} drove from its "
        f"junction {o.vertex} to {o.end} ({o.length:.1f} m): it leaves junction {o.other_vertex} "
        f"of {o.other.run}, where that run turned another way"
    )


class _Option(NamedTuple):
    """A corridor that the run `known` drove from `vertex` to `end`, length in [m], and that the run
    `other` saw leave its `other_vertex`, matched with `vertex`, and did not drive."""

    known: Prepared
    vertex: int
    end: int
    length: float
    other: Prepared
    other_vertex: int


def _partners_of(candidate: Candidate | None) -> dict[int, int]:
    """The vertex of a by its partner in b."""
    if candidate is None:
        return {}
    return dict(zip(candidate.b.tolist(), candidate.a.tolist(), strict=True))


def _refutes(option: _Option, blind: Mapping[int, int], a: Prepared) -> bool:
    """Whether the runner-up matches the junction with another one, so that the corridor can refute
    it."""
    o = option
    ours, theirs = (o.vertex, o.other_vertex) if o.known is a else (o.other_vertex, o.vertex)
    return blind.get(theirs, ours) != ours


def _driven_by_one(
    known: Prepared, other: Prepared, vk: IntArray, vo: IntArray, turn: float
) -> list[_Option]:
    """Corridors of `known` at matched junctions by branches that `other` saw and did not drive."""
    partner = np.full(len(known), -1)
    partner[vk] = vo
    row = ((partner[known.tail] >= 0) & (known.leave != NO_BRANCH)).nonzero()[0]
    tail = known.tail[row]
    vertex, theirs = partner[tail], other.heading[partner[tail]]
    gap = np.abs(wrap(theirs - (known.heading[tail, known.leave[row]] - turn)[:, None]))
    gap[np.isnan(theirs)] = np.pi  # as far off as can be
    branch = gap.argmin(axis=1)
    open_ = (gap.min(axis=1) < LIKELIHOOD.branch_gate_rad) & (other.by_branch[vertex, branch] < 0)
    columns = (tail, known.head[row], known.length[row], vertex)
    return [
        _Option(known, u, end, length, other, v)
        for u, end, length, v in zip(*(c[open_].tolist() for c in columns), strict=True)
    ]
