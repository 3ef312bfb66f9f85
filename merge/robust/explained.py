"""Why the robust method decided on two runs as it did, from the documents of a workspace.

The verdict, its evidence and what it lacks are those of the merge (`merged.json`). The terms of the
evidence, link by link, are those of the match of the two maps, which is cached by the merge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.digits import BITS, rounded
from ...topology.matching.views import compare
from ...topology.se2 import between, turned
from ...topology.topomap import TopoMap
from ...topology.wording import counted
from ..decision import COMMON_LENGTH, Decision, Placement, Requirement, Term
from ..kept import Kept
from ..locks import Lock, discarded, lock_table
from ..result import Alignment, CopyTest, MergeResult, PairVerdict, Verdict, pairs_of, shown_bits
from ..through import joined_through
from ..wording import SAME_PLACE, decimals
from .alignment import Candidate, match
from .conflicts import contradictions
from .decide import decide
from .entries import alignment_of
from .forced import forced_alignment
from .pairing import Means, Pairwise
from .prepare import Prepared
from .settings import DEFAULT_ROBUST, MATCH, RobustSettings
from .verdict import rounded_up
from .view_search import pictured

FIT_SIGMAS = 1.96
"""Two measurements of one length differ by less in 95 % of cases. A link that fits so well and is
still evidence against the placement has a common length."""

BOTH = np.array([(0, 1)])
"""The pair of the two maps of a `_Pair`."""


@dataclass(frozen=True, slots=True, eq=False)
class Merge:
    """A merge as stated by its documents.

    read: gives the map of a run; runs: number of its runs; verdicts: by pair, none if these runs
    were not merged; settings: of the merge; locks: present ones; poses: (3,) of every run in its
    component; kept: cached results of matching.
    """

    read: Callable[[str], TopoMap]
    runs: int
    verdicts: Mapping[tuple[str, str], PairVerdict] = field(default_factory=dict)
    settings: RobustSettings = DEFAULT_ROBUST
    locks: Sequence[Lock] = ()
    poses: Mapping[str, FloatArray] = field(default_factory=dict)
    kept: Kept = field(default_factory=Kept)

    @classmethod
    def of(
        cls,
        result: MergeResult,
        read: Callable[[str], TopoMap],
        settings: RobustSettings = DEFAULT_ROBUST,
        locks: Sequence[Lock] = (),
        kept: Kept | None = None,
    ) -> Merge:
        """The merge of a result."""
        verdicts = {(v.a, v.b): v for v in result.verdicts}
        poses = {run: pose for c in result.components for run, pose in c.poses.items()}
        return cls(read, len(poses), verdicts, settings, locks, poses, kept or Kept())


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two maps of a merge, prepared."""

    merge: Merge
    matcher: Pairwise

    def alone(self) -> PairVerdict:
        """The verdict on the two maps by themselves, as one of all pairs of the merge."""
        settings, pairs = self.merge.settings, rounded_up(pairs_of(self.merge.runs))
        one_of = replace(settings, false_merge_rate=settings.false_merge_rate / pairs)
        return decide(self.matcher.maps, one_of, means=self.matcher.means)[0]

    @cached_property
    def plain(self) -> tuple[Candidate, ...]:
        """The candidates of the two maps."""
        (beyond,) = self.matcher.candidates(BOTH)
        a, b = self.matcher.prepared
        return beyond or match(a, b, self.merge.settings)

    def candidates(self, verdict: PairVerdict) -> Iterator[Candidate]:
        """All candidates, last the placement by a lock of the two as the same."""
        yield from self.plain
        lock = lock_table(self.merge.locks).get((verdict.a, verdict.b))
        if lock is not None and lock.decision == "same":
            a, b = self.matcher.prepared
            forced = forced_alignment(a, b, self.plain, lock, self.merge.settings)
            yield from () if forced is None else (forced,)

    def known(self, verdict: PairVerdict, alignment: Alignment) -> Candidate | None:
        """The candidate of an alignment in the document, if the maps still have it."""
        pairs = set(map(tuple, alignment.matched.tolist()))
        matching = (c for c in self.candidates(verdict) if pairs == {*_matched_pairs(c)})
        return next(matching, None)

    def placements(self, verdict: PairVerdict) -> Iterator[Placement]:
        """The placement that a verdict refers to, or the best one, and the runner-up."""
        if verdict.accepted_by == "components" and verdict.best is not None:
            # Of fused maps; of maps that changed since, some junctions may be gone.
            matched, sizes = verdict.best.matched, [len(m) for m in self.matcher.maps]
            known_matches = matched[(matched < sizes).all(axis=1)]
            yield Placement(replace(verdict.best, matched=known_matches), ())
            return
        best = None if verdict.verdict is Verdict.UNRELATED else verdict.best
        chosen = None if best is None else self.known(verdict, best)
        chosen = chosen or next(self.candidates(verdict), None)
        if chosen is not None:
            yield self._placement(chosen, verdict.best)
        if chosen is not None and verdict.runner_up is not None:
            second = self.known(verdict, verdict.runner_up)
            yield from () if second is None else (self._placement(second, verdict.runner_up),)

    def _placement(self, c: Candidate, stated: Alignment | None) -> Placement:
        """A candidate with its evidence, as far as the document states it."""
        a, b = self.matcher.prepared
        alignment = alignment_of(c, a, b)
        copy_test = None if stated is None else stated.copy_test
        if stated is not None and copy_test is not None:
            alignment = replace(alignment, evidence_bits=stated.evidence_bits, copy_test=copy_test)
        return Placement(alignment, _terms(a, b, c, alignment.evidence_bits, copy_test), c.searched)


def _matched_pairs(c: Candidate) -> Iterator[tuple[int, int]]:
    """The matched vertices of a candidate, pair by pair."""
    return zip(c.a.tolist(), c.b.tolist(), strict=True)


def explain(merge: Merge, a: str, b: str) -> Decision:
    """Why two runs a < b were merged or not, or would be by their two maps alone. Raises what
    `Merge.read` does."""
    maps = merge.read(a), merge.read(b)
    pair = _Pair(merge, Pairwise(maps, merge.settings, Means(kept=merge.kept)))
    listed = (a, b) in merge.verdicts
    unlisted = not listed and a in merge.poses and b in merge.poses
    verdict = merge.verdicts[a, b] if listed else pair.alone()
    verdict = _unlisted(merge, verdict) if unlisted else verdict
    chain = (a, *verdict.through, b) if verdict.through else ()
    others = bool(chain) and {a, b} <= merge.poses.keys()
    return Decision(
        pair=verdict,
        of_merge=unlisted or listed,
        requirement=_requirement(merge, verdict),
        placements=tuple(pair.placements(verdict)),
        by_others=between(merge.poses[a], merge.poses[b]) if others else None,
        chain=tuple(
            (x, y, merge.verdicts[min(x, y), max(x, y)].evidence_bits) for x, y in pairwise(chain)
        ),
        why="" if verdict.accepted else verdict.lacks,
        notes=_lock_notes(merge, verdict) if listed and not discarded(verdict) else (),
    )


def _unlisted(merge: Merge, alone: PairVerdict) -> PairVerdict:
    """The verdict on a pair that the merge did not list: its own assessment, and through which runs
    others join the two, if they do."""
    pair = (alone.a, alone.b)
    known = [*merge.verdicts.values(), replace(alone, accepted=False)]
    through = joined_through(known).get(pair, ())
    if alone.verdict is Verdict.UNRELATED:
        return replace(alone, through=through)
    return PairVerdict(
        *pair,
        Verdict.UNRELATED,
        False,
        alone.evidence_bits,
        f"not matched among so many runs, as no corridors that hang together look alike enough; "
        f"matched now: {alone.reason}",
        threshold_bits=alone.threshold_bits,
        through=through,
        lacks=alone.lacks,
    )


def _terms(
    a: Prepared, b: Prepared, c: Candidate, bits: float, copy_test: CopyTest | None
) -> tuple[Term, ...]:
    """The terms of the evidence of a placement. They add up to `bits` if it was tested for being a
    copy, else to the evidence against chance."""
    bound_bits = c.counted_bits - c.bits
    terms = [
        *_link_terms(a, b, c),
        *_branch_terms(a, b, c),
        *_view_terms(a, b, c),
        *_conflict_terms(a, b, c),
    ]
    terms.append(Term("hypotheses", -c.tested_bits, _describe_choice(c)))
    if rounded(bound_bits, BITS) < 0:
        cap = f"cap: {MATCH.junction_bits} bits for each matched junction"
        terms.append(Term("few", bound_bits, cap))
    if copy_test is not None:
        copies = min(rounded(bits, BITS) - c.counted_bits, 0.0)
        digits = decimals(copy_test.bits, copy_test.needed_bits)
        known, need = (shown_bits(b, digits) for b in (copy_test.bits, copy_test.needed_bits))
        limits = "; limits the sum" if copies else ""
        terms.append(Term("copies", copies, f"{SAME_PLACE}: {known} of {need} bits{limits}"))
    return tuple(terms)


def _describe_choice(c: Candidate) -> str:
    """Among how many hypotheses a candidate was chosen, in words."""
    if c.by_views:
        return "proposed by views"
    tested = round(2.0**c.tested_bits - 1)
    return f"chosen from {counted(tested, 'pair')} of like corridors"


def _link_terms(a: Prepared, b: Prepared, c: Candidate) -> Iterator[Term]:
    """A term for each link between matched junctions."""
    support = c.support
    rows = zip(support.ends.tolist(), support.along.tolist(), support.links.tolist(), strict=True)
    for ends, along, bits in rows:
        va, vb = tuple(c.a[ends].tolist()), tuple(c.b[ends].tolist())
        if along >= 0:
            row_a, row_b = support.corridors[along].tolist()
            size = (float(a.length[row_a]), float(b.length[row_b]))
            sigma_m = math.sqrt(a.variance[row_a] + b.variance[row_b])
            fits = abs(size[0] - size[1]) < FIT_SIGMAS * sigma_m
            kind = COMMON_LENGTH if fits else "misfit"
            yield Term("corridor", bits, "corridor" if bits >= 0 else kind, va, vb, size)
        else:
            gap_a, gap_b = a.z[va[1]] - a.z[va[0]], b.z[vb[1]] - b.z[vb[0]]
            size = (float(abs(gap_a)), float(abs(gap_b)))
            yield Term("position", bits, "distance", va, vb, size)


def _branch_terms(a: Prepared, b: Prepared, c: Candidate) -> Iterator[Term]:
    """A term for the branches of each matched junction."""
    for (u, v), bits in zip(_matched_pairs(c), c.support.branches.tolist(), strict=True):
        yield Term("branches", bits, f"{a.count[u]} and {b.count[v]} branches", (u,), (v,))


def _view_terms(a: Prepared, b: Prepared, c: Candidate) -> Iterator[Term]:
    """A term for each part of the overlap. The strongest one for the placement and the strongest
    one against it come with their strongest pair of views and the junctions nearest to these."""
    count, bits = np.bincount(c.views.cell, minlength=len(c.views.bits)), c.views.bits
    for k, part in enumerate(bits.tolist()):
        term = Term("views", part, counted(int(count[k]), "pair of views", "pairs of views"))
        extreme = int(bits.argmax() if part > 0 else bits.argmin())
        if part == 0.0 or k != extreme:
            yield term
            continue
        rows = np.flatnonzero(c.views.cell == k)
        row = int(rows[np.argmax(np.sign(part) * c.views.z[rows])])
        seen_a, seen_b = pictured(a.views), pictured(b.views)
        first, second = int(c.views.first[row]), int(c.views.second[row])
        near_a = int(np.abs(a.z - seen_a.place[first]).argmin())
        near_b = int(np.abs(b.z - seen_b.place[second]).argmin())
        comparison = compare(seen_a.index, seen_b.index, (first, second), c.views.transform[row])
        comparison = replace(comparison, xy=turned(comparison.xy, seen_a.pose[first, 2]))
        yield replace(term, a=(near_a,), b=(near_b,), seen=comparison)


def _conflict_terms(a: Prepared, b: Prepared, c: Candidate) -> Iterator[Term]:
    """A term for each contradiction."""
    described = {
        "unseen": "junction unseen in a corridor",
        "elsewhere": "corridors that lead elsewhere",
    }
    for x in contradictions(c.conflicts, a, b):
        yield Term(x.kind, -x.bits, described[x.kind], x.of_a, x.of_b)


def _requirement(merge: Merge, verdict: PairVerdict) -> Requirement:
    """The requirements for merging. The number of pairs that share the rate of false merges (all of
    the merge, or those still open when components joined a pair) follows from the threshold."""
    settings, threshold = merge.settings, verdict.threshold_bits or 0.0
    exact_bits = threshold - 10.0**-BITS / 2  # it was rounded, as pairs will be, up
    lead = None if verdict.accepted_by == "components" else verdict.lead_needed_bits
    return Requirement(
        threshold_bits=threshold,
        pairs=rounded_up(round(2.0**exact_bits * settings.false_merge_rate)),
        false_merge_rate=settings.false_merge_rate,
        least_junctions=settings.min_matches,
        lead_bits=MATCH.lead_bits if lead is None else lead,
        junction_bits=MATCH.junction_bits,
    )


def _lock_notes(merge: Merge, verdict: PairVerdict) -> tuple[str, ...]:
    """A note if a lock was set or cleared since the merge, or is infeasible."""
    lock = lock_table(merge.locks).get((verdict.a, verdict.b))
    decision = None if lock is None else lock.decision
    if decision != verdict.locked:
        words = {"same": "locked as the same", "never": "locked apart", None: "unlocked"}[decision]
        return (f"{words} since the merge; merge again",)
    if decision == "same" and not verdict.accepted:
        return (verdict.reason.partition("; the maps alone say")[0],)
    return ()
