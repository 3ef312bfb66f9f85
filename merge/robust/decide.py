"""The robust method: from maps to a verdict for every pair of runs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from ...topology.topomap import TopoMap
from ..locks import Lock, Names, locks_among
from ..result import Alignment, PairVerdict
from .alignment import Candidate, match
from .batch import Batch, in_batches
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

    All pairs of a small batch; of a large one those that were matched. The others were screened out
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
    batch.log(f"{len(joined)} pairs join, {len(matches)} by what components say together")
    refused |= batch.match_overlapping(components, matches)
    return tuple(
        _verdicts(batch, components, forced=forced, locked=locked, refused=refused, matches=matches)
    )


def _forced(batch: Batch, locked: Mapping[Pair, Lock]) -> dict[Pair, Candidate]:
    """Alignments of the pairs that are locked as the same. Candidates are those of the assessment
    first, which are ranked with the test for copies, then all that matching finds."""
    same = [pair for pair, lock in sorted(locked.items()) if lock.decision == "same"]
    settings = batch.matcher.settings
    forced = {}
    for pair, assessment in batch.assessments(same).items():
        a, b = batch.prepared(pair)
        ranked = (w.candidate for w in assessment.ranked)
        candidates = (*ranked, *match(a, b, settings))
        alignment = forced_alignment(a, b, candidates, locked[pair], settings)
        if alignment is not None:
            forced[pair] = alignment
    return forced


def _join(
    batch: Batch, components: Components, forced: Mapping[Pair, Candidate]
) -> tuple[dict[Pair, Alignment], dict[Pair, Refusal]]:
    """Join pairs, locked ones first, then by evidence. Returns the alignments of the pairs that are
    joined or agree with those, and why the others are refused.

    A pair locked as the same is joined as the lock states or, if that is infeasible, not at all.
    """
    merged = ((pair, v.best) for pair, v in batch.unlocked.items() if v.accepted)
    alignments = {pair: best for pair, best in merged if best is not None}
    alignments |= {pair: as_alignment(c) for pair, c in forced.items()}
    bits = {pair: batch.verdicts[pair].evidence_bits for pair in alignments}
    order = sorted(alignments, key=lambda p: (p not in forced, -bits[p], p))
    matcher = batch.matcher
    across = Across(
        matcher.prepared,
        batch.unlocked,
        alignments,
        batch.same_place_bits,
        locked=forced,
        most_sigmas=matcher.settings.size_sigmas,
    )
    refused = join_all(components, order, alignments, matcher.prepared, refusal=across.refusal)
    return {pair: a for pair, a in alignments.items() if pair not in refused}, refused


def _rematch(
    batch: Batch,
    components: Components,
    joined: Mapping[Pair, Alignment],
    locked: Mapping[Pair, Lock],
    forced: Collection[Pair],
) -> dict[Pair, ComponentMatch]:
    """Join components by the evidence of their merged maps. Locks that name junctions constrain
    these matches, too, unless an alignment of their own pair satisfies them."""
    unmet = {
        pair: lock.at
        for pair, lock in locked.items()
        if lock.at is not None and lock.decision == "same" and pair not in forced
    }
    rematcher = Rematcher(
        batch.matcher, components, batch.plausible(), batch.threshold, batch.discarded, unmet
    )
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

    The verdict by the two maps alone stands unless a lock, a refusal, a match of components or
    other runs concern the pair. Then the pair is assessed again, with all of these.
    """
    concerned = {*forced, *locked, *refused, *matches}
    for pairs in in_batches(sorted(batch.summaries)):
        open_pairs = (p for p in pairs if p in concerned or not batch.verdicts[p].accepted)
        corroborated = batch.corroborated(open_pairs, components)
        revised = [pair for pair in pairs if pair in concerned or pair in corroborated]
        assessments = batch.assessments(revised)
        for pair in pairs:
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
