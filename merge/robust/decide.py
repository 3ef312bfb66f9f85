"""The robust method: from maps to a verdict for every pair of runs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from ...topology.topomap import TopoMap
from ..locks import Lock, Names, locks_among
from ..result import Alignment, PairVerdict
from .alignment import Candidate, match
from .batch import Batch, in_parts
from .components import Across, Components, Refusal, as_alignment, join_all
from .entries import Case
from .forced import forced_alignment
from .pairing import Means, Pair, Pairwise
from .rematching import ComponentMatch, Rematcher
from .settings import DEFAULT_ROBUST, RobustSettings


def decide(
    maps: Sequence[TopoMap],
    settings: RobustSettings = DEFAULT_ROBUST,
    *,
    locks: Sequence[Lock] = (),
    discarded: Collection[Names] = (),
    means: Means | None = None,
) -> tuple[PairVerdict, ...]:
    """Verdicts on pairs of runs, sorted by (a, b); `maps` are sorted by run.

    All pairs of a small batch; of a large one those that were matched: the others were screened out
    (`screening`) and are unrelated unless other runs join them.

    1. Every map is prepared, and matched with itself: how much does the building repeat itself?
    2. Every pair that passes screening is matched: candidate alignments with evidence against
       chance and against being a copy.
    3. Each pair by itself is merged, ambiguous or unrelated; "merged" must lead every rival
       placement and the mirror image.
    4. Merged pairs are joined, strongest first, subject to locks and to the consistency of cycles
       and of copies.
    5. The merged maps of components are matched again: evidence adds up over their runs, and fewer
       pairs remain that could be merged wrongly. They, too, must lead their mirror images.
    6. Pairs that stayed open take over the placement by the joined runs; pairs that now overlap are
       matched after all.

    Locks of runs that are not among the maps are ignored. Discarded matches, by the names of their
    runs in order, are treated as not found. Raises UsageError on locks that contradict each other
    or name a vertex that does not exist.
    """
    row = {m.run: k for k, m in enumerate(maps)}
    among = locks_among(locks, {m.run: m for m in maps})
    locked = {(row[a], row[b]): lock for (a, b), lock in among.items()}
    batch = Batch(
        Pairwise(maps, settings, means),
        frozenset(locked),
        frozenset((row[a], row[b]) for a, b in sorted(discarded) if a in row and b in row),
    )
    batch.match_likely()
    forced = _forced(batch, locked)
    never = [pair for pair, lock in locked.items() if lock.decision == "never"]
    components = Components(len(maps), never)
    joined, refused = _join(batch, components, forced)
    matches = _rematch(batch, components, joined, locked, forced)
    batch.say(f"{len(joined)} pairs join, {len(matches)} by what components say together")
    refused |= batch.match_overlapping(components, matches)
    found = _verdicts(
        batch, components, forced=forced, locked=locked, refused=refused, matches=matches
    )
    return tuple(found)


def _forced(batch: Batch, locked: Mapping[Pair, Lock]) -> dict[Pair, Candidate]:
    """Alignments of the pairs that are locked as the same: of those that `explain` shows, which
    are ranked with the test for copies, else of all that the match finds."""
    same = [pair for pair, lock in sorted(locked.items()) if lock.decision == "same"]
    settings = batch.matcher.settings
    out = {}
    for pair, assessment in batch.assessments(same).items():
        a, b = batch.prepared(pair)
        shown = (w.candidate for w in assessment.ranked)
        candidates = (*shown, *match(a, b, settings))
        found = forced_alignment(a, b, candidates, locked[pair], settings)
        if found is not None:
            out[pair] = found
    return out


def _join(
    batch: Batch, components: Components, forced: Mapping[Pair, Candidate]
) -> tuple[dict[Pair, Alignment], dict[Pair, Refusal]]:
    """Join pairs, locked ones first, then by evidence: the alignments of those that join or fit,
    and why others do not.

    A pair locked as the same is joined as the lock says or, if that is infeasible, not at all.
    """
    merged = ((pair, v.best) for pair, v in batch.unlocked.items() if v.accepted)
    best = {pair: found for pair, found in merged if found is not None}
    best |= {pair: as_alignment(c) for pair, c in forced.items()}
    bits = {pair: batch.verdicts[pair].evidence_bits for pair in best}
    order = sorted(best, key=lambda p: (p not in forced, -bits[p], p))
    matcher = batch.matcher
    across = Across(
        matcher.prepared,
        matcher.places,
        batch.unlocked,
        best,
        batch.same_place_bits,
        locked=forced,
        most_sigmas=matcher.settings.size_sigmas,
    )
    runs = [m.run for m in matcher.maps]
    refused = join_all(components, order, best, matcher.places, runs, refusal=across.refusal)
    return {pair: found for pair, found in best.items() if pair not in refused}, refused


def _rematch(
    batch: Batch,
    components: Components,
    joined: Mapping[Pair, Alignment],
    locked: Mapping[Pair, Lock],
    forced: Collection[Pair],
) -> dict[Pair, ComponentMatch]:
    """Join components by what their merged maps say; locks that name junctions, and that no
    alignment of their own pair honours, hold for these as well."""
    unmet = {
        pair: lock.at
        for pair, lock in locked.items()
        if lock.at is not None and lock.decision == "same" and pair not in forced
    }
    open_ = batch.plausible()
    rematcher = Rematcher(batch.matcher, components, open_, batch.threshold, batch.discarded, unmet)
    return rematcher.run(joined)


def _verdicts(
    batch: Batch,
    components: Components,
    *,
    forced: Mapping[Pair, Candidate],
    locked: Mapping[Pair, Lock],
    refused: Mapping[Pair, Refusal],
    matches: Mapping[Pair, ComponentMatch],
) -> Iterator[PairVerdict]:
    """The verdicts on all pairs that were matched, sorted.

    A verdict from the two maps alone stands unless a lock, a component or other runs concern the
    pair. Those are assessed again, with the placements that other runs corroborate.
    """
    concerned = {*forced, *locked, *refused, *matches}
    for some in in_parts(sorted(batch.found)):
        open_ = (p for p in some if p in concerned or not batch.verdicts[p].accepted)
        corroborated = batch.corroborated(open_, components)
        again = [pair for pair in some if pair in concerned or pair in corroborated]
        assessments = batch.assessments(again)
        for pair in some:
            if pair not in assessments:
                yield batch.verdicts[pair]
                continue
            case = Case(
                *batch.prepared(pair),
                assessments[pair],
                forced=forced.get(pair),
                lock=locked.get(pair),
                refused=refused.get(pair),
                by_components=matches.get(pair),
                corroborated=corroborated.get(pair),
                together=components.together(*pair),
            )
            yield case.verdict()
