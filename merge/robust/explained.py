"""Why the robust method decided on two runs as it did, from the documents of a workspace.

The pair is assessed again by the functions that `decide` calls, with the settings and the pair
count of the merge; the contributions of other runs and locks are read from its document.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.digits import BITS, rounded
from ...topology.se2 import between
from ...topology.topomap import TopoMap
from ...topology.wording import counted
from ..decision import Decision, Placement, Requirement, Start, Term, TermKind
from ..discards import discarded
from ..locks import Lock, lock_table
from ..result import Alignment, PairVerdict, Verdict, pairs_of, shown_bits
from ..through import joined_through
from ..wording import told_bits
from .alignment import Candidate, best_seed, same_placement
from .assessment import AssessedPair, assess_pair, thresholds
from .conflicts import one_by_one
from .forced import forced_alignment
from .growth import given_up
from .pairing import Pair
from .prepare import Prepared, prepare
from .rematching import view_of_components
from .settings import DEFAULT_ROBUST, MATCH, RobustSettings
from .shown_views import most_telling
from .verdict import Answers, Assessment, PairCount, counted_bits, in_steps, needed_bits

SAME_BITS, SAME_M, SAME_RAD = 0.02, 0.01, 0.001
"""Verdicts that differ by less are the same up to the rounding of documents."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """A merge as stated by its documents.

    maps: of all its runs that can still be read, sorted by run; said: its verdict on every pair,
    empty if there was no merge: these maps are then taken to be a batch; settings: of the merge;
    locks: present ones; poses: (3,) of every run in its component; row: index of each map by run;
    against_chance: evidence against chance of the pairs for which the merge states any [bits].
    """

    maps: Sequence[TopoMap]
    said: Mapping[tuple[str, str], PairVerdict]
    settings: RobustSettings = DEFAULT_ROBUST
    locks: Sequence[Lock] = ()
    poses: Mapping[str, FloatArray] = field(default_factory=dict)
    row: Mapping[str, int] = field(init=False)
    against_chance: Mapping[tuple[str, str], float] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", {m.run: i for i, m in enumerate(self.maps)})
        told = {pair: v.extra.get("against_chance_bits", 0.0) for pair, v in self.said.items()}
        stated = {pair: bits for pair, bits in told.items() if bits}
        object.__setattr__(self, "against_chance", stated)

    def count(self, joined: PairVerdict | None = None) -> PairCount:
        """The pairs that shared the false-merge rate, or those that still did when components
        joined a pair; pairs of earlier versions without that entry count as beyond chance."""
        pairs = pairs_of(len(self.poses)) or len(self.said) or pairs_of(len(self.maps))
        if joined is not None and joined.accepted_by == "components" and joined.threshold_bits:
            least = joined.threshold_bits - 10.0**-BITS / 2  # it was rounded, as pairs will be, up
            pairs = round(2.0**least * self.settings.false_merge_rate)
        if not self.against_chance:
            return PairCount(pairs, pairs)
        need = needed_bits(pairs, self.settings)
        return PairCount(pairs, sum(bits >= need for bits in self.against_chance.values()))

    @property
    def linked(self) -> list[Pair] | None:
        """The pairs with a placement better than chance; None if there was no merge, or an earlier
        version's without that entry."""
        if not self.against_chance:
            return None
        beyond = (p for p, bits in self.against_chance.items() if bits > MATCH.lead_bits)
        return [(self.row[a], self.row[b]) for a, b in beyond if {a, b} <= self.row.keys()]

    def unlisted(self, a: str, b: str) -> bool:
        """Whether a pair is one of those that a large merge counted but did not list."""
        return (a, b) not in self.said and a in self.poses and b in self.poses


def explain(batch: Batch, a: str, b: str) -> Decision:
    """Why two runs a < b were merged or not. Raises KeyError if the map of one is missing."""
    pair = (a, b)
    rows = (batch.row[a], batch.row[b])
    own = assess_pair(batch.maps, rows, batch.settings, count=batch.count(), linked=batch.linked)
    alone = own.alone()
    unlisted = batch.unlisted(a, b)
    told = _unlisted(batch, alone) if unlisted else batch.said.get(pair, alone)
    shown, start = _shown(batch, own, told)
    placements = tuple(placement for placement, _ in shown)
    return Decision(
        said=told,
        of_merge=unlisted or pair in batch.said,
        requirement=_requirement(batch, told, own.view, shown[0][1] if shown else None),
        placements=placements,
        start=start,
        by_others=_by_others(batch, told),
        why="" if told.accepted else own.view.why,
        notes=_notes(batch, told, alone, placements) if pair in batch.said else (),
    )


def _notes(
    batch: Batch, told: PairVerdict, alone: PairVerdict, placements: Sequence[Placement]
) -> tuple[str, ...]:
    """Notes on a pair of the last merge."""
    if discarded(told):  # nothing of it was counted, so that nothing can differ
        return ()
    return (*_lock_notes(batch, told), *_changed(told, alone, placements))


def _unlisted(batch: Batch, alone: PairVerdict) -> PairVerdict:
    """The verdict on a pair that the merge did not list: its own assessment, and through which runs
    others join the two, if they do."""
    pair = (alone.a, alone.b)
    known = [*batch.said.values(), replace(alone, accepted=False)]
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
    )


def _by_others(batch: Batch, told: PairVerdict) -> FloatArray | None:
    """T_a_b of two runs that only others join."""
    if not told.through or told.a not in batch.poses or told.b not in batch.poses:
        return None
    return between(batch.poses[told.a], batch.poses[told.b])


Shown = tuple[Placement, Answers]


def _shown(batch: Batch, own: AssessedPair, told: PairVerdict) -> tuple[list[Shown], Start | None]:
    """The placement that the verdict refers to and the next best one; without any, the best
    hypothesis."""
    if told.accepted_by == "components" and told.together is not None:
        return _of_components(batch, told, told.together), None
    chosen = _chosen(batch, own, told)
    if chosen is None:
        return _of_seed(own, batch.settings)
    others = (c for c, _ in own.view.ranked if not same_placement(c, chosen, own.b))
    rival = next(others, None)
    found = [chosen] if rival is None else [chosen, rival]
    return [_placement_of(own, c) for c in found], None


def _chosen(batch: Batch, own: AssessedPair, told: PairVerdict) -> Candidate | None:
    """The candidate that the verdict refers to: the one in the document, else the best."""
    known = [*(c for c, _ in own.view.ranked), *own.candidates]
    for lock in batch.locks:
        if (lock.a, lock.b, lock.decision) == (told.a, told.b, "same"):
            forced = forced_alignment(own.a, own.b, own.candidates, lock, batch.settings)
            known += [] if forced is None else [forced]
    if told.best is not None:
        pairs = {tuple(p) for p in told.best.matched.tolist()}
        same = (c for c in known if set(zip(c.a.tolist(), c.b.tolist(), strict=True)) == pairs)
        if (found := next(same, None)) is not None:
            return found
    return next(iter(known), None)


def _placement_of(own: AssessedPair, c: Candidate) -> Shown:
    view = own.view
    asked = zip(view.ranked, view.answers, strict=True)
    answers = next(
        (a for (r, _), a in asked if r is c),
        Answers(view.need_bits, c.bits, counted_bits(c)),
    )
    terms = _terms(_Naming(own.a, own.b), c, answers)
    return Placement(own.alignment(c, answers.bits), terms, c.searched), answers


def _of_seed(own: AssessedPair, settings: RobustSettings) -> tuple[list[Shown], Start | None]:
    """The best hypothesis if none grew, and why."""
    best = best_seed(own.a, own.b, settings)
    if best is None:
        return [], None
    lanes, seed, candidate, count = best
    found, expected = given_up(lanes, seed, settings)
    needed = max(MATCH.fewest, ceil(MATCH.least_share * expected))
    return [_placement_of(own, candidate)], Start(found, expected, needed, count)


def _of_components(
    batch: Batch, told: PairVerdict, sides: tuple[tuple[str, ...], tuple[str, ...]]
) -> list[Shown]:
    """The placement of a pair that its components joined, with their evidence."""
    x, y = (tuple(batch.row[run] for run in side if run in batch.row) for side in sides)
    threshold_of = thresholds([prepare(m) for m in batch.maps], batch.settings, batch.linked)
    threshold = threshold_of((*x, *y), batch.count(told))
    inside = {
        (batch.row[a], batch.row[b]): v.best
        for (a, b), v in batch.said.items()
        if v.accepted_by in ("pair", "lock", "components")
        and a in batch.row
        and b in batch.row
        and v.best is not None
    }
    one, two, view = view_of_components(batch.maps, (x, y), inside, threshold, batch.settings)
    if view.best is None or told.best is None:
        return []
    swapped = told.a not in one.names
    runs = (told.b, told.a) if swapped else (told.a, told.b)
    naming = _Naming(
        one.prepared,
        two.prepared,
        [members.get(runs[0], ())[:1] for members in one.members],
        [members.get(runs[1], ())[:1] for members in two.members],
        swapped,
    )
    answers = view.answers[0]
    # Of maps that changed since, some junctions may be gone.
    sizes = [len(batch.maps[batch.row[run]]) for run in (told.a, told.b)]
    matched = told.best.matched[(told.best.matched < sizes).all(axis=1)]
    shown = replace(told.best, matched=matched, corridors=len(view.best.corridors))
    return [(Placement(shown, _terms(naming, view.best, answers)), answers)]


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


def _terms(naming: _Naming, c: Candidate, answers: Answers) -> tuple[Term, ...]:
    """The evidence of a placement, part by part; the parts add up to `answers.bits`."""
    few = answers.carried - answers.against_chance
    copies = answers.bits - answers.carried
    terms = [*_links(naming, c), *_branches(naming, c), *_views(naming, c), *_against(naming, c)]
    terms.append(naming.term("hypotheses", -c.tested_bits, _chosen_from(c)))
    if rounded(few, BITS) < 0:
        told = f"what agrees counts {MATCH.junction_bits} bits a junction at most"
        terms.append(naming.term("few", few, told))
    if answers.same_place is not None:
        terms.append(
            naming.term("copies", copies, _copy_told(answers.same_place, answers.need_same))
        )
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
    tested = round(2.0**c.tested_bits - 1)
    if c.by_views:
        return f"chosen from {counted(tested, 'pair')} of views, in four turns"
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


def _requirement(
    batch: Batch, told: PairVerdict, view: Assessment, answers: Answers | None
) -> Requirement:
    """The requirements for merging; view: of the two maps alone."""
    settings, pairs = batch.settings, batch.count(told).all
    asked = answers is not None and answers.same_place is not None
    return Requirement(
        threshold_bits=needed_bits(pairs, settings),
        pairs=in_steps(pairs),
        unrounded_pairs=None if in_steps(pairs) == pairs else pairs,
        false_merge_rate=settings.false_merge_rate,
        least_junctions=settings.min_matches,
        lead_bits=MATCH.lead_bits if told.accepted_by == "components" else view.lead_bits,
        junction_bits=MATCH.junction_bits,
        repetition=0.0 if answers is None else answers.repetition,
        same_place_bits=answers.same_place if answers is not None and asked else None,
        same_place_needed=answers.need_same if answers is not None and asked else None,
    )


def _changed(
    told: PairVerdict, alone: PairVerdict, placements: Sequence[Placement]
) -> tuple[str, ...]:
    """A note if the maps no longer give what the document says."""
    now = alone.evidence_bits
    if told.accepted_by not in (None, "pair") and placements:
        now = sum(term.bits for term in placements[0].terms)
    same = abs(now - told.evidence_bits) < SAME_BITS
    if told.accepted_by in (None, "pair") and told.locked is None and not _set_aside(told, alone):
        same &= told.verdict == alone.verdict
    if told.best is not None and placements:
        same &= _alike(told.best, placements[0].alignment)
    if same:
        return ()
    was, is_now = shown_bits(told.evidence_bits), shown_bits(now)
    differ = f"the merge says {was} bits, the maps now say {is_now}"
    if was == is_now:
        differ = "the maps no longer say just what the merge says"
    return (f"{differ}: they, the locks or topobatch have changed since; merge again",)


def _lock_notes(batch: Batch, told: PairVerdict) -> tuple[str, ...]:
    """A note if a lock was set or cleared since the merge, or is infeasible."""
    lock = lock_table(batch.locks).get((told.a, told.b))
    now = None if lock is None else lock.decision
    if now != told.locked:
        what = {"same": "locked as the same", "never": "locked apart", None: "unlocked"}[now]
        return (f"{what} since the merge; merge again",)
    if now == "same" and not told.accepted:
        return (told.reason.partition("; the maps alone say")[0],)
    return ()


def _set_aside(told: PairVerdict, alone: PairVerdict) -> bool:
    """Whether the pair would be merged by itself and was kept out by other runs."""
    return alone.accepted and not told.accepted


def _alike(x: Alignment, y: Alignment) -> bool:
    off = between(x.transform, y.transform)
    return bool(np.hypot(off[0], off[1]) < SAME_M and abs(off[2]) < SAME_RAD)
