"""The robust method: from maps to a verdict for every pair of runs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...topology.digits import BITS, rounded
from ...topology.errors import UsageError
from ...topology.topomap import TopoMap
from ..discards import REASON, Names
from ..locks import Lock, lock_table
from ..result import AcceptedBy, Alignment, PairVerdict, Verdict, pairs_of
from .advice import advice
from .alignment import Candidate, match, same_placement, self_matches
from .batch import Batch, wanted_pairs
from .components import Components, Refusal, as_alignment, join_all
from .forced import forced_alignment
from .mirror import doubt_mirrored, mirrored
from .pairing import Means, Pair, Pairwise, Samples
from .prepare import Prepared, prepare
from .rematching import Rematcher, Reunion
from .repetition import CopyModel, copy_model
from .settings import DEFAULT_ROBUST, MATCH, RobustSettings
from .verdict import (
    Bar,
    Opinion,
    PairCount,
    bar,
    counted_bits,
    opinion,
)
from .wording import contradictions, nothing, summary


def decide(
    maps: Sequence[TopoMap],
    settings: RobustSettings = DEFAULT_ROBUST,
    *,
    locks: Sequence[Lock] = (),
    discarded: Collection[Names] = (),
    means: Means | None = None,
) -> tuple[PairVerdict, ...]:
    """Verdicts on pairs of runs, sorted by (a, b); `maps` are sorted by run.

    Of a small batch on every pair. Of a large one on those that were matched: the others have no
    chance (`index`) and are unrelated, as far as no other runs join them.

    1. Every map is prepared, and matched with itself: how much does the building repeat itself?
    2. Every pair with a chance is matched: candidate alignments with evidence against chance and
       for sameness.
    3. Each pair by itself is merged, ambiguous or unrelated; "merged" must fit better than its
       mirror image.
    4. Merged pairs are joined, strongest first, locks honoured, cycles checked.
    5. The merged maps of components are matched again: evidence adds up over their runs, and fewer
       pairs are left that may be merged wrongly. They, too, must fit better than their mirror
       images.
    6. What the joined runs say of the pairs that stayed open is taken over; pairs that now lie over
       each other are matched after all.

    Locks of runs that are not among the maps are left alone. Discarded matches, by the names of
    their runs in order, are as if they had not been found. Raises UsageError on locks that
    contradict each other or name a vertex that does not exist.
    """
    runs = [m.run for m in maps]
    matcher = Pairwise(maps, settings, means)
    prepared = matcher.prepared
    locked = _locked_pairs(maps, locks)
    row = {run: k for k, run in enumerate(runs)}
    gone = [(row[a], row[b]) for a, b in sorted(discarded) if a in row and b in row]

    def alone(pair: Pair, view: Opinion) -> PairVerdict:
        i, j = pair
        return _by_evidence(prepared[i], prepared[j], _Case(view), _says(view))

    bar_of = bars(prepared, settings, matcher.with_themselves(), matcher.copies)
    batch = Batch(matcher, bar_of, alone, frozenset(locked))
    wanted = wanted_pairs(matcher, [*locked, *gone])
    matcher.means.say(f"{len(maps)} maps, {len(wanted)} of {pairs_of(len(maps))} pairs to match")
    batch.look_at(wanted, gone)
    forced = _forced(prepared, locked, settings)
    never = [pair for pair, lock in locked.items() if lock.decision == "never"]
    components = Components(len(maps), never)
    best, order = _strongest_first(batch, forced)
    refused = join_all(components, order, best, matcher.places, runs)
    kept = {pair: found for pair, found in best.items() if pair not in refused}
    rematcher = Rematcher(
        maps,
        prepared,
        components,
        batch.undecided(),
        batch.level,
        settings,
        frozenset(gone),
        matcher.means.kept,
    )
    reunions = rematcher.run(kept)
    matcher.means.say(f"{len(kept)} pairs join, {len(reunions)} by what components say together")
    refused |= batch.look_again(components, reunions)
    said = Others(forced, locked, refused, reunions)
    return tuple(_verdicts(batch, components, said))


@dataclass(frozen=True, slots=True, eq=False)
class Others:
    """What was said of some pairs by others than their two maps."""

    forced: Mapping[Pair, Candidate]
    locked: Mapping[Pair, Lock]
    refused: Mapping[Pair, Refusal]
    reunions: Mapping[Pair, Reunion]

    def of(self, pair: Pair) -> bool:
        """Whether there is anything."""
        return any(pair in of for of in (self.forced, self.locked, self.refused, self.reunions))


def _verdicts(batch: Batch, components: Components, said: Others) -> Iterator[PairVerdict]:
    """The verdicts on all pairs that were matched, sorted."""
    prepared = batch.matcher.prepared
    pairs = sorted(batch.found)
    held = {pair: v for pair, v in (batch.joins | batch.alone).items() if not said.of(pair)}
    asked = [pair for pair in pairs if pair not in batch.joins or pair not in held]
    second = batch.seconded(asked, components)
    kept = batch.known_seconded({pair: n for pair, n in second.items() if pair in held})
    held = {pair: v for pair, v in held.items() if pair not in second} | kept
    again = batch.views([pair for pair in pairs if pair not in held])
    fresh = {}
    for pair in pairs:
        if pair in held:
            yield held[pair]
            continue
        i, j = pair
        view, candidates = again[pair]
        known = batch.opinions.get(pair)
        if known is not None:
            view = _as_known(view, known)
        case = _Case(
            view=view,
            forced=said.forced.get(pair),
            lock=said.locked.get(pair),
            refused=said.refused.get(pair),
            reunion=said.reunions.get(pair),
            seconded=candidates[second[pair]] if pair in second else None,
            together=components.together(i, j),
        )
        told = _verdict(prepared[i], prepared[j], case)
        if pair in batch.alone and pair in second and not said.of(pair):
            fresh[pair] = told
        yield told
    batch.keep_seconded(fresh, second)


def _as_known(view: Opinion, known: Opinion) -> Opinion:
    """What two maps say again, with what their mirror images and a person had to add."""
    return replace(view, verdict=known.verdict, why=known.why, discarded=known.discarded)


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """What two maps of a batch say by themselves, and what they must reach."""

    a: Prepared
    b: Prepared
    candidates: tuple[Candidate, ...]
    level: Bar
    view: Opinion

    def alone(self) -> PairVerdict:
        """The verdict on the pair, were there no locks and no other runs to say more."""
        return _by_evidence(self.a, self.b, _Case(self.view), _says(self.view))

    def alignment(self, chosen: Candidate, bits: float) -> Alignment:
        """A candidate as an alignment of so much evidence."""
        return _alignment(chosen, self.a, self.b, bits)


def assess(
    maps: Sequence[TopoMap], pair: Pair, settings: RobustSettings, *, count: PairCount
) -> Assessment:
    """Steps 1 to 3 of `decide` for one pair of a batch of so many pairs; `maps` are those of the
    batch, sorted by run, `pair` two of their indices, i < j."""
    prepared = [prepare(m) for m in maps]
    i, j = pair
    level = bars(prepared, settings)(pair, count)
    found = match(prepared[i], prepared[j], settings)
    view = opinion(prepared[i], prepared[j], found, level)

    def image_bits(pairs: list[Pair]) -> dict[Pair, float]:
        best = {p: match(prepared[i], prepare(mirrored(maps[j])), settings) for p in pairs}
        return {p: c[0].bits if c else -np.inf for p, c in best.items()}

    view = doubt_mirrored({pair: view}, image_bits)[pair]
    return Assessment(prepared[i], prepared[j], found, level, view)


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """All that was said about one pair: by itself, by a person, by the other runs."""

    view: Opinion
    forced: Candidate | None = None
    lock: Lock | None = None
    refused: Refusal | None = None
    reunion: Reunion | None = None
    seconded: Candidate | None = None
    together: bool = False


def _locked_pairs(maps: Sequence[TopoMap], locks: Sequence[Lock]) -> dict[Pair, Lock]:
    """The locks that concern these maps, by indices."""
    index = {m.run: i for i, m in enumerate(maps)}
    out: dict[Pair, Lock] = {}
    for (a, b), lock in lock_table(locks).items():
        if a not in index or b not in index:
            continue
        pair = (index[a], index[b])
        for run, vertex in zip(pair, lock.at or (), strict=False):
            if vertex >= len(maps[run]):
                raise UsageError(
                    f"the lock of {a!r} and {b!r} names junction {vertex} of {maps[run].run!r}, "
                    f"which has {len(maps[run])}: lock by the numbers in its map document"
                )
        out[pair] = lock
    return out


def bars(
    prepared: Sequence[Prepared],
    settings: RobustSettings,
    with_themselves: Sequence[tuple[Candidate, ...]] | None = None,
    copies_of: Callable[[Samples], CopyModel] | None = None,
) -> Callable[[Sequence[int], PairCount], Bar]:
    """What some maps, a pair or those of two components, must reach in a batch of so many pairs.
    with_themselves: matches of each map with other parts of itself, if they are known; copies_of:
    stands for `copy_model`."""
    own = with_themselves or list(self_matches(prepared, settings))
    samples = [(k, c) for k, found in enumerate(own) for c in found if c.bits > MATCH.lead_bits]
    if copies_of is None:
        copies = copy_model([(prepared[k], c) for k, c in samples], settings)
    else:
        copies = copies_of(samples)
    copied = _copied(own, settings)

    def level(some: Sequence[int], count: PairCount) -> Bar:
        return bar(count, copies, settings, copied=max(copied[k] for k in some))

    return level


def _copied(
    with_themselves: Sequence[tuple[Candidate, ...]], settings: RobustSettings
) -> list[float]:
    """The junctions of every map's largest copy of a part of itself, no fewer than most maps of the
    batch have."""
    copied = [
        max((len(c) for c in own if c.bits > MATCH.lead_bits), default=0) for own in with_themselves
    ]
    batch = float(np.quantile(copied, settings.copied_share)) if copied else 0.0
    return [max(junctions, batch) for junctions in copied]


def _forced(
    prepared: Sequence[Prepared],
    locked: dict[Pair, Lock],
    settings: RobustSettings,
) -> dict[Pair, Candidate]:
    """Alignments of the pairs that are locked as the same."""
    out = {}
    for (i, j), lock in sorted(locked.items()):
        if lock.decision == "same":
            candidates = match(prepared[i], prepared[j], settings)
            found = forced_alignment(prepared[i], prepared[j], candidates, lock, settings)
            if found is not None:
                out[i, j] = found
    return out


def _strongest_first(
    batch: Batch, forced: Mapping[Pair, Candidate]
) -> tuple[dict[Pair, Alignment], list[Pair]]:
    """The alignments to join by, and their order: a person's locks first, then by evidence.

    A locked pair is joined as the lock says or, where nothing honours it, not at all.
    """
    best = {pair: v.best for pair, v in batch.joins.items() if v.best is not None}
    bits = {pair: batch.joins[pair].evidence_bits for pair in best}
    best |= {pair: as_alignment(c) for pair, c in forced.items()}
    bits |= {pair: batch.opinions[pair].bits for pair in forced}
    order = sorted(best, key=lambda p: (p not in forced, -bits[p], p))
    return best, order


def _verdict(a: Prepared, b: Prepared, case: _Case) -> PairVerdict:
    """One entry of the result. A person's word comes first, then the safety of the component, then
    the pair's own evidence, then what the other runs say."""
    view = case.view
    says = _says(view)
    if case.lock is not None and case.lock.decision == "never":
        reason = f"locked apart by a person; the maps alone say: {says}"
        return _entry(a, b, case, Verdict.UNRELATED, reason)
    if case.lock is not None and case.forced is None and case.reunion is None:
        return _dishonoured(a, b, case, case.lock, says)
    if case.refused is not None:
        reason = f"{says}; but {case.refused.reason}"
        if case.lock is not None:
            reason = f"locked as the same, but {case.refused.reason}; the maps alone say: {says}"
        return _entry(a, b, case, Verdict.AMBIGUOUS, reason)
    return _by_evidence(a, b, case, says)


def _says(view: Opinion) -> str:
    """What the two maps say by themselves, as a clause."""
    if view.discarded:
        return REASON
    if view.best is None:
        return nothing(view.faint, view.need_bits)
    return summary(view.best, view.bits, view.need_bits, view.margin)


def _dishonoured(a: Prepared, b: Prepared, case: _Case, lock: Lock, says: str) -> PairVerdict:
    """The entry of a pair that is locked as the same, where no alignment can be found for that."""
    reason = "locked as the same, but no alignment of the two honours the lock"
    if case.together:
        reason = f"{reason}; other runs place them in one component"
    elif lock.at is None:
        reason = f"{reason}: name a junction of each run in it"
    verdict = case.view.verdict
    if verdict is Verdict.MERGED:  # by an alignment that the lock rules out
        verdict = Verdict.AMBIGUOUS
    return _entry(a, b, case, verdict, f"{reason}; the maps alone say: {says}")


def _by_evidence(a: Prepared, b: Prepared, case: _Case, says: str) -> PairVerdict:
    """The entry of a pair that nobody forbids."""
    view = case.view
    if case.forced is not None:
        return _accepted(
            a, b, case, case.forced, by="lock", reason="locked as the same by a person; {}"
        )
    if view.verdict is Verdict.MERGED and view.best is not None:
        return _accepted(a, b, case, view.best, by="pair")
    if case.reunion is not None:
        said = case.reunion
        found = (said.alignment, None, said.margin)
        return _joined(a, b, case, said.reason, found, by="components")
    if case.seconded is not None:
        told = "{}; other runs place the two in the same way"
        return _accepted(a, b, case, case.seconded, by="runs", reason=told)
    reason = f"{says}; {view.why}" if view.why else says
    return _entry(a, b, case, view.verdict, reason)


def _accepted(
    a: Prepared, b: Prepared, case: _Case, chosen: Candidate, *, by: AcceptedBy, reason: str = "{}"
) -> PairVerdict:
    """The entry of a pair joined by an alignment of its own, which need not be its best. The
    alignment's summary stands in the reason's braces."""
    known = (bits for c, bits in case.view.ranked if c is chosen)
    bits = next(known, counted_bits(chosen))
    others = (r for r in case.view.ranked if not same_placement(r[0], chosen, b))
    second = next((_alignment(c, a, b, bits) for c, bits in others), None)
    margin = None if second is None else bits - second.evidence_bits
    told = reason.format(summary(chosen, bits, case.view.need_bits, margin))
    return _joined(a, b, case, told, (_alignment(chosen, a, b, bits), second, margin), by=by)


def _joined(
    a: Prepared,
    b: Prepared,
    case: _Case,
    reason: str,
    found: tuple[Alignment, Alignment | None, float | None],
    *,
    by: AcceptedBy,
) -> PairVerdict:
    """The entry of a pair that is joined; found: its alignment, the next best one, the lead."""
    best, runner_up, margin = found
    return PairVerdict(
        a=a.run,
        b=b.run,
        verdict=Verdict.MERGED,
        accepted=True,
        evidence_bits=best.evidence_bits,
        threshold_bits=case.reunion.need_bits
        if by == "components" and case.reunion
        else case.view.need_bits,
        reason=reason,
        best=best,
        runner_up=runner_up,
        margin_bits=margin,
        accepted_by=by,
        together=case.reunion.sides if by == "components" and case.reunion else None,
        locked=_decision(case),
        extra=_extra(case),
    )


def _entry(a: Prepared, b: Prepared, case: _Case, verdict: Verdict, reason: str) -> PairVerdict:
    """The entry of a pair that is not joined."""
    view = case.view
    shown = [_alignment(c, a, b, bits) for c, bits in view.ranked[:2]]
    settling = None if case.refused is None else case.refused.advice
    if verdict is Verdict.AMBIGUOUS and settling is None:
        settling = advice(a, b, view)
    return PairVerdict(
        a=a.run,
        b=b.run,
        verdict=verdict,
        accepted=False,
        evidence_bits=view.bits,
        threshold_bits=view.need_bits,
        reason=reason,
        best=shown[0] if shown else None,
        runner_up=shown[1] if len(shown) > 1 else None,
        margin_bits=view.margin,
        advice=settling,
        locked=_decision(case),
        extra=_extra(case),
    )


def _decision(case: _Case) -> str | None:
    return None if case.lock is None else case.lock.decision


def _extra(case: _Case) -> dict[str, float]:
    view = case.view
    out = {}
    if view.against_chance > 0:
        out["against_chance_bits"] = view.against_chance
    if view.same_bits is not None:
        out["same_place_bits"] = rounded(view.same_bits, BITS)
    return out


def _alignment(c: Candidate, a: Prepared, b: Prepared, bits: float) -> Alignment:
    order = np.argsort(c.a, kind="stable")
    against = contradictions(c, a, b)
    return Alignment(
        transform=c.transform,
        evidence_bits=bits,
        matched=np.column_stack([c.a, c.b])[order],
        rmse_m=c.rmse_m,
        corridors=len(c.corridors),
        contradictions=tuple(told for told, _, _ in against),
        contradicting=tuple((of_a, of_b) for _, of_a, of_b in against),
    )
