"""Why the robust method decided on two runs as it did, from the documents of a workspace.

The verdict, its evidence and what it lacks are those of the merge (`merged.json`). What the
evidence of a placement consists of, link by link, is read off the match of the two maps, which is
the same as when they were merged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from math import ceil

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.digits import BITS, rounded
from ...topology.se2 import between
from ...topology.topomap import TopoMap
from ...topology.wording import counted
from ..decision import Decision, Placement, Requirement, Start, Term, TermKind
from ..discards import discarded
from ..kept import Kept
from ..locks import Lock, lock_table
from ..result import Alignment, CopyTest, PairVerdict, Verdict, pairs_of, shown_bits
from ..through import joined_through
from ..wording import told_bits
from .alignment import Candidate, best_seed, match, same_placement
from .conflicts import one_by_one
from .decide import decide
from .entries import alignment_of
from .forced import forced_alignment
from .growth import given_up
from .pairing import Means, Pairwise
from .prepare import Prepared
from .rematching import linked_junctions, matches_of_components
from .settings import DEFAULT_ROBUST, MATCH, RobustSettings
from .shown_views import most_telling
from .verdict import counted_bits, in_steps, needed_bits

SAME_BITS, SAME_M, SAME_RAD = 0.02, 0.01, 0.001
"""Verdicts that differ by less are the same up to the rounding of documents."""
BOTH = np.array([(0, 1)])
"""The pair of the two maps of a `_Pair`."""


@dataclass(frozen=True, slots=True, eq=False)
class Merge:
    """A merge as stated by its documents.

    read: gives the map of a run; runs: number of all its runs; said: its verdicts, none if these
    runs were not merged; settings: of the merge; locks: present ones; poses: (3,) of every run in
    its component; kept: results of matching that need not be computed again.
    """

    read: Callable[[str], TopoMap]
    runs: int
    said: Mapping[tuple[str, str], PairVerdict] = field(default_factory=dict)
    settings: RobustSettings = DEFAULT_ROBUST
    locks: Sequence[Lock] = ()
    poses: Mapping[str, FloatArray] = field(default_factory=dict)
    kept: Kept = field(default_factory=Kept)

    def pairs(self, told: PairVerdict) -> int:
        """The pairs that shared the false-merge rate, or those that still did when components
        joined a pair."""
        if told.accepted_by != "components" or not told.threshold_bits:
            return pairs_of(self.runs)
        least = told.threshold_bits - 10.0**-BITS / 2  # it was rounded, as pairs will be, up
        pairs: int = round(2.0**least * self.settings.false_merge_rate)
        return pairs


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two maps of a merge, prepared."""

    merge: Merge
    matcher: Pairwise

    @classmethod
    def of(cls, merge: Merge, a: str, b: str) -> _Pair:
        """Two runs of a merge."""
        maps = merge.read(a), merge.read(b)
        return cls(merge, Pairwise(maps, merge.settings, Means(kept=merge.kept)))

    @property
    def a(self) -> Prepared:
        """The map of the first run."""
        return self.matcher.prepared[0]

    @property
    def b(self) -> Prepared:
        """The map of the second run."""
        return self.matcher.prepared[1]

    def alone(self) -> PairVerdict:
        """What the two maps say by themselves, as one of all pairs of the merge."""
        settings, pairs = self.merge.settings, in_steps(pairs_of(self.merge.runs))
        one_of = replace(settings, false_merge_rate=settings.false_merge_rate / pairs)
        return decide(self.matcher.maps, one_of, means=self.matcher.means)[0]

    @cached_property
    def plain(self) -> tuple[Candidate, ...]:
        """The candidates of the two maps."""
        (beyond,) = self.matcher.candidates(BOTH)
        return beyond or match(self.a, self.b, self.merge.settings)

    @cached_property
    def beside_rivals(self) -> tuple[Candidate, ...]:
        """The same including all other hypotheses beyond chance."""
        (beyond,) = self.matcher.beside_rivals(BOTH)
        return beyond or match(self.a, self.b, self.merge.settings, rivals=True)

    def candidates(self, told: PairVerdict) -> Iterator[Candidate]:
        """All of them, first those that the verdict is about: a pair is merged by itself only
        beside rivals."""
        if told.accepted_by == "pair":
            yield from self.beside_rivals
        yield from self.plain
        if told.accepted_by != "pair":
            yield from self.beside_rivals

    def chosen(self, told: PairVerdict) -> Candidate | None:
        """The candidate that the verdict refers to: the one in the document, else the best."""
        best = None if told.verdict is Verdict.UNRELATED else told.best
        if best is not None and (found := self.known(told, best)) is not None:
            return found
        return next(self.candidates(told), None)

    def known(self, told: PairVerdict, alignment: Alignment) -> Candidate | None:
        """The candidate of an alignment in the document, if the maps still have it."""
        same = (c for c in self.candidates(told) if _of(c, alignment))
        return next(chain(same, filter(lambda c: _of(c, alignment), self._forced(told))), None)

    def _forced(self, told: PairVerdict) -> Iterator[Candidate]:
        """The placement by a lock of the two as the same."""
        for lock in self.merge.locks:
            if (lock.a, lock.b, lock.decision) == (told.a, told.b, "same"):
                forced = forced_alignment(self.a, self.b, self.plain, lock, self.merge.settings)
                yield from () if forced is None else (forced,)

    def next_best(self, told: PairVerdict, chosen: Candidate) -> Candidate | None:
        """The candidate of the runner-up."""
        if told.verdict is not Verdict.UNRELATED:
            return None if told.runner_up is None else self.known(told, told.runner_up)
        beyond = (c for c in self.candidates(told) if c.bits > MATCH.lead_bits)
        return next((c for c in beyond if not same_placement(c, chosen, self.b)), None)

    def placement(self, c: Candidate, known: Alignment | None) -> Placement:
        """A candidate with its evidence, as far as the document tells it."""
        own = alignment_of(c, self.a, self.b, None)
        tested = None if known is None else known.copy_test
        if known is not None and tested is not None:
            own = replace(own, evidence_bits=known.evidence_bits, copy_test=tested)
        terms = _terms(_Naming(self.a, self.b), c, own.evidence_bits, tested)
        return Placement(own, terms, c.searched)


def _of(c: Candidate, alignment: Alignment) -> bool:
    """Whether a candidate matches what an alignment does."""
    pairs = set(map(tuple, alignment.matched.tolist()))
    return set(zip(c.a.tolist(), c.b.tolist(), strict=True)) == pairs


def explain(merge: Merge, a: str, b: str) -> Decision:
    """Why two runs a < b were merged or not, or would be by their two maps alone. Raises what
    `Merge.read` does."""
    pair = _Pair.of(merge, a, b)
    listed = (a, b) in merge.said
    unlisted = not listed and a in merge.poses and b in merge.poses
    told = merge.said[a, b] if listed else pair.alone()
    told = _unlisted(merge, told) if unlisted else told
    start = None
    if told.accepted_by == "components" and told.together is not None:
        placements = _of_components(merge, told, told.together)
    elif (chosen := pair.chosen(told)) is None:
        placements, start = _of_seed(pair)
    else:
        rival = pair.next_best(told, chosen)
        placements = [pair.placement(chosen, _tested(told))]
        placements += [] if rival is None else [pair.placement(rival, told.runner_up)]
    return Decision(
        said=told,
        of_merge=unlisted or listed,
        requirement=_requirement(merge, told, placements),
        placements=tuple(placements),
        start=start,
        by_others=_by_others(merge, told),
        why="" if told.accepted else told.lacks,
        notes=_notes(merge, told, placements) if listed else (),
    )


def _tested(told: PairVerdict) -> Alignment | None:
    """The alignment of a verdict with its test for a copy. Of runs that a person locked apart the
    document states that alone."""
    if "copy_test" not in told.extra:
        return told.best
    tested, nothing = CopyTest(**told.extra["copy_test"]), np.zeros((0, 2), np.int64)
    return Alignment(np.zeros(3), told.evidence_bits, nothing, 0.0, copy_test=tested)


def _notes(merge: Merge, told: PairVerdict, placements: Sequence[Placement]) -> tuple[str, ...]:
    """Notes on a pair of the last merge."""
    if discarded(told):  # nothing of it was counted, so that nothing can differ
        return ()
    return (*_lock_notes(merge, told), *_changed(told, placements))


def _unlisted(merge: Merge, alone: PairVerdict) -> PairVerdict:
    """The verdict on a pair that the merge did not list: its own assessment, and through which runs
    others join the two, if they do."""
    pair = (alone.a, alone.b)
    known = [*merge.said.values(), replace(alone, accepted=False)]
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
        extra=alone.extra,
    )


def _by_others(merge: Merge, told: PairVerdict) -> FloatArray | None:
    """T_a_b of two runs that only others join."""
    if not told.through or told.a not in merge.poses or told.b not in merge.poses:
        return None
    return between(merge.poses[told.a], merge.poses[told.b])


def _of_seed(pair: _Pair) -> tuple[list[Placement], Start | None]:
    """The best hypothesis if none grew, and why."""
    settings = pair.merge.settings
    best = best_seed(pair.a, pair.b, settings)
    if best is None:
        return [], None
    lanes, seed, candidate, count = best
    found, expected = given_up(lanes, seed, settings)
    needed = max(MATCH.fewest, ceil(MATCH.least_share * expected))
    return [pair.placement(candidate, None)], Start(found, expected, needed, count)


def _tied(merge: Merge, told: PairVerdict, best: Alignment) -> Alignment:
    """The alignment of a pair with its ties by views, which documents do not state."""
    if told.accepted_by == "components" or not all(
        len(merge.read(run).views) for run in (told.a, told.b)
    ):
        return best
    pair = _Pair.of(merge, told.a, told.b)
    found = pair.known(told, best)
    return best if found is None else alignment_of(found, pair.a, pair.b, None)


def _of_components(
    merge: Merge, told: PairVerdict, sides: tuple[tuple[str, ...], tuple[str, ...]]
) -> list[Placement]:
    """The placement of a pair that its components joined, with their evidence."""
    runs = sorted((*sides[0], *sides[1]))
    row = {run: k for k, run in enumerate(runs)}
    maps = [merge.read(run) for run in runs]
    inside = {
        (row[a], row[b]): _tied(merge, v, v.best)
        for (a, b), v in merge.said.items()
        if v.accepted_by in ("pair", "lock", "components")
        and a in row
        and b in row
        and v.best is not None
    }
    x, y = (tuple(row[run] for run in side) for side in sides)
    one, two, candidates = matches_of_components(maps, (x, y), inside, merge.settings, merge.kept)
    if told.best is None or not candidates:
        return []
    ends, asked = (row[told.a], row[told.b]), told.best.matched.tolist()
    linked = (linked_junctions(one, two, c).get(ends) for c in candidates)
    same = (
        c for c, own in zip(candidates, linked, strict=True) if own and asked == [*map(list, own)]
    )
    best = next(same, candidates[0])
    swapped = told.a not in one.names
    names = (told.b, told.a) if swapped else (told.a, told.b)
    naming = _Naming(
        one.prepared,
        two.prepared,
        [members.get(names[0], ())[:1] for members in one.members],
        [members.get(names[1], ())[:1] for members in two.members],
        swapped,
    )
    # Of maps that changed since, some junctions may be gone.
    sizes = [len(maps[k]) for k in ends]
    matched = told.best.matched[(told.best.matched < sizes).all(axis=1)]
    shown = replace(told.best, matched=matched, corridors=len(best.corridors))
    return [Placement(shown, _terms(naming, best, shown.evidence_bits, shown.copy_test))]


@dataclass(frozen=True, slots=True, eq=False)
class _Naming:
    """Two matched maps, and for each of their vertices the junctions of the two runs in question
    behind it, or the vertices themselves if None. swapped: `one` holds run b and `two` run a."""

    one: Prepared
    two: Prepared
    of_one: Sequence[tuple[int, ...]] | None = None
    of_two: Sequence[tuple[int, ...]] | None = None
    swapped: bool = False

    def term(
        self,
        kind: TermKind,
        bits: float,
        told: str,
        *,
        one: Sequence[int] = (),
        two: Sequence[int] = (),
        size_m: tuple[float, float] | None = None,
    ) -> Term:
        """A term about vertices of the two maps."""
        first, second = _behind(self.of_one, one), _behind(self.of_two, two)
        if self.swapped:
            first, second = second, first
            size_m = size_m and size_m[::-1]
        return Term(kind, bits, told, first, second, size_m)


def _behind(
    junctions: Sequence[tuple[int, ...]] | None, vertices: Sequence[int]
) -> tuple[int, ...]:
    """The junctions behind all of these vertices; none if one of them has none."""
    if junctions is None:
        return tuple(vertices)
    found = [v for vertex in vertices for v in junctions[vertex]]
    return tuple(found) if len(found) == len(vertices) else ()


def _terms(naming: _Naming, c: Candidate, bits: float, tested: CopyTest | None) -> tuple[Term, ...]:
    """The evidence of a placement, part by part; the parts add up to `bits` if it was tested for
    being a copy, else to what speaks against chance."""
    few = counted_bits(c) - c.bits
    terms = [*_links(naming, c), *_branches(naming, c), *_views(naming, c), *_against(naming, c)]
    terms.append(naming.term("hypotheses", -c.tested_bits, _chosen_from(c)))
    if rounded(few, BITS) < 0:
        told = f"what agrees counts {MATCH.junction_bits} bits a junction at most"
        terms.append(naming.term("few", few, told))
    if tested is not None:
        copies = min(rounded(bits, BITS) - counted_bits(c), 0.0)
        terms.append(naming.term("copies", copies, _copy_told(tested.bits, tested.needed_bits)))
    return tuple(terms)


def _copy_told(same_place: float, need_same: float) -> str:
    bits, need = told_bits(same_place, need_same).removesuffix(" needed").split(" bits, ")
    if bits.startswith("-"):
        return f"is it a copy? {bits[1:]} bits say yes, {need} for no needed"
    return f"is it a copy? {bits} bits say no, {need} needed"


def _views(naming: _Naming, c: Candidate) -> list[Term]:
    seen = np.bincount(c.views.cell, minlength=len(c.views.bits)).tolist()
    bits, shown = c.views.bits.tolist(), most_telling(naming.one, naming.two, c)
    out = []
    for k, (n, part) in enumerate(zip(seen, bits, strict=True)):
        told = counted(n, "pair of views", "pairs of views")
        most = shown.get(k)
        if most is None:
            out.append(naming.term("views", part, told))
            continue
        near = naming.term("views", part, told, one=[most.near_a], two=[most.near_b])
        out.append(replace(near, seen=most.laid.swapped if naming.swapped else most.laid))
    return out


def _chosen_from(c: Candidate) -> str:
    if c.by_views:
        return "proposed by views"
    tested = round(2.0**c.tested_bits - 1)
    return f"chosen from {counted(tested, 'pair')} of like corridors"


def _links(naming: _Naming, c: Candidate) -> list[Term]:
    a, b, agree = naming.one, naming.two, c.support
    out = []
    rows = zip(agree.ends.tolist(), agree.along.tolist(), agree.links.tolist(), strict=True)
    for ends, along, bits in rows:
        va, vb = c.a[ends].tolist(), c.b[ends].tolist()
        if along >= 0:
            row_a, row_b = agree.corridors[along].tolist()
            size = (float(a.length[row_a]), float(b.length[row_b]))
            told = "corridor" if bits >= 0 else "misfit"
            out.append(naming.term("corridor", bits, told, one=va, two=vb, size_m=size))
        else:
            gap_a, gap_b = a.z[va[1]] - a.z[va[0]], b.z[vb[1]] - b.z[vb[0]]
            size = (float(abs(gap_a)), float(abs(gap_b)))
            told = "distance"
            out.append(naming.term("position", bits, told, one=va, two=vb, size_m=size))
    return out


def _branches(naming: _Naming, c: Candidate) -> list[Term]:
    rows = zip(c.a.tolist(), c.b.tolist(), c.support.branches.tolist(), strict=True)
    out = []
    for u, v, bits in rows:
        told = f"{naming.one.count[u]} and {naming.two.count[v]} branches"
        out.append(naming.term("branches", bits, told, one=[u], two=[v]))
    return out


def _against(naming: _Naming, c: Candidate) -> list[Term]:
    told = {
        "unseen": "junction unseen in a corridor",
        "elsewhere": "corridors that lead elsewhere",
    }
    found = one_by_one(c.conflicts, naming.one, naming.two)
    return [naming.term(x.kind, -x.bits, told[x.kind], one=x.of_a, two=x.of_b) for x in found]


def _requirement(merge: Merge, told: PairVerdict, placements: Sequence[Placement]) -> Requirement:
    """The requirements for merging."""
    settings, pairs = merge.settings, merge.pairs(told)
    tested = placements[0].alignment.copy_test if placements else None
    lead = None if told.accepted_by == "components" else told.lead_needed_bits
    return Requirement(
        threshold_bits=needed_bits(pairs, settings),
        pairs=in_steps(pairs),
        unrounded_pairs=None if in_steps(pairs) == pairs else pairs,
        false_merge_rate=settings.false_merge_rate,
        least_junctions=settings.min_matches,
        lead_bits=MATCH.lead_bits if lead is None else lead,
        junction_bits=MATCH.junction_bits,
        repetition=0.0 if tested is None else tested.repetition,
        same_place_bits=None if tested is None else tested.bits,
        same_place_needed=None if tested is None else tested.needed_bits,
    )


def _changed(told: PairVerdict, placements: Sequence[Placement]) -> tuple[str, ...]:
    """A note if the maps no longer give what the document says."""
    now = 0.0
    if placements and (told.verdict is not Verdict.UNRELATED or told.evidence_bits):
        now = sum(term.bits for term in placements[0].terms)
    same = abs(now - told.evidence_bits) < SAME_BITS
    if told.best is not None and placements:
        same &= _alike(told.best, placements[0].alignment)
    if same:
        return ()
    was, is_now = shown_bits(told.evidence_bits), shown_bits(now)
    differ = f"the merge says {was} bits, the maps now say {is_now}"
    if was == is_now:
        differ = "the maps no longer say just what the merge says"
    return (f"{differ}: they, the locks or topobatch have changed since; merge again",)


def _lock_notes(merge: Merge, told: PairVerdict) -> tuple[str, ...]:
    """A note if a lock was set or cleared since the merge, or is infeasible."""
    lock = lock_table(merge.locks).get((told.a, told.b))
    now = None if lock is None else lock.decision
    if now != told.locked:
        what = {"same": "locked as the same", "never": "locked apart", None: "unlocked"}[now]
        return (f"{what} since the merge; merge again",)
    if now == "same" and not told.accepted:
        return (told.reason.partition("; the maps alone say")[0],)
    return ()


def _alike(x: Alignment, y: Alignment) -> bool:
    off = between(x.transform, y.transform)
    return bool(np.hypot(off[0], off[1]) < SAME_M and abs(off[2]) < SAME_RAD)
