"""The robust method: from maps to a verdict for every pair of runs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from ...topology.topomap import TopoMap
from ..discards import Names
from ..locks import Lock, locks_among
from ..result import Alignment, PairVerdict, pairs_of
from .across import Across
from .alignment import Candidate, match
from .batch import Batch, in_parts, wanted_pairs
from .components import Components, Refusal, as_alignment, join_all
from .forced import forced_alignment
from .pairing import Means, Pair, Pairwise
from .rematching import Rematcher, Reunion
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
    (`index`) and are unrelated unless other runs join them.

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
    matcher = Pairwise(maps, settings, means)
    say, named = matcher.means.say, [m.run for m in maps]
    row = {m.run: k for k, m in enumerate(maps)}
    among = locks_among(locks, {m.run: m for m in maps})
    locked = {(row[a], row[b]): lock for (a, b), lock in among.items()}
    batch = Batch(matcher, frozenset(locked), frozenset(_pairs_named(row, discarded)))
    wanted = wanted_pairs(matcher, {*batch.locked, *batch.discarded})
    say(f"{len(maps)} maps, {len(wanted)} of {pairs_of(len(maps))} pairs to match")
    batch.match(wanted)
    forced = _forced(batch, locked)
    never = [pair for pair, lock in locked.items() if lock.decision == "never"]
    components = Components(len(maps), never)
    best, order = _strongest_first(batch, forced)
    across = Across(
        matcher.prepared,
        matcher.places,
        batch.unlocked,
        best,
        batch.same_place_bits,
        locked=forced,
        most_sigmas=settings.size_sigmas,
    )
    refused = join_all(components, order, best, matcher.places, named, refusal=across.refusal)
    joined = {pair: found for pair, found in best.items() if pair not in refused}
    unmet = {
        pair: lock.at
        for pair, lock in locked.items()
        if lock.at is not None and lock.decision == "same" and pair not in forced
    }
    rematcher = Rematcher(
        matcher, components, batch.undecided(), batch.threshold, batch.discarded, unmet
    )
    reunions = rematcher.run(joined)
    say(f"{len(joined)} pairs join, {len(reunions)} by what components say together")
    refused |= batch.match_overlapping(components, reunions)
    return tuple(_verdicts(batch, components, Others(forced, locked, refused, reunions)))


def _pairs_named(row: Mapping[str, int], names: Collection[Names]) -> list[Pair]:
    """The pairs of runs that are among the maps, by indices."""
    return [(row[a], row[b]) for a, b in sorted(names) if a in row and b in row]


def _forced(batch: Batch, locked: dict[Pair, Lock]) -> dict[Pair, Candidate]:
    """Alignments of the pairs that are locked as the same: as they are shown to who locks them,
    also where copies are ranked otherwise than by chance."""
    same = [pair for pair, lock in sorted(locked.items()) if lock.decision == "same"]
    prepared, settings = batch.matcher.prepared, batch.matcher.settings
    out = {}
    for (i, j), assessment in batch.assessments(same).items():
        shown = (w.candidate for w in assessment.ranked)
        candidates = (*shown, *match(prepared[i], prepared[j], settings))
        found = forced_alignment(prepared[i], prepared[j], candidates, locked[i, j], settings)
        if found is not None:
            out[i, j] = found
    return out


def _strongest_first(
    batch: Batch, forced: Mapping[Pair, Candidate]
) -> tuple[dict[Pair, Alignment], list[Pair]]:
    """The alignments to join by, and their order: locks first, then by evidence.

    A pair locked as the same is joined as the lock says or, if that is infeasible, not at all.
    """
    joins = ((pair, v) for pair, v in batch.unlocked.items() if v.accepted)
    best = {pair: v.best for pair, v in joins if v.best is not None}
    best |= {pair: as_alignment(c) for pair, c in forced.items()}
    bits = {pair: batch.verdicts[pair].evidence_bits for pair in best}
    order = sorted(best, key=lambda p: (p not in forced, -bits[p], p))
    return best, order


@dataclass(frozen=True, slots=True, eq=False)
class Others:
    """Locks, refusals and component matches of some pairs."""

    forced: Mapping[Pair, Candidate]
    locked: Mapping[Pair, Lock]
    refused: Mapping[Pair, Refusal]
    reunions: Mapping[Pair, Reunion]

    def concern(self, pair: Pair) -> bool:
        """Whether there is any of a pair."""
        every = (self.forced, self.locked, self.refused, self.reunions)
        return any(pair in some for some in every)


def _verdicts(batch: Batch, components: Components, others: Others) -> Iterator[PairVerdict]:
    """The verdicts on all pairs that were matched, sorted.

    A verdict from the two maps alone stands unless a lock, a component or other runs concern the
    pair. Those are assessed again, with the placements that other runs corroborate.
    """
    for some in in_parts(sorted(batch.found)):
        concerned = {pair for pair in some if others.concern(pair)}
        open_ = (pair for pair in some if pair in concerned or not batch.verdicts[pair].accepted)
        corroborated = batch.corroborated(open_, components)
        again = [pair for pair in some if pair in concerned or pair in corroborated]
        assessments = batch.assessments(again)
        for pair in some:
            if pair not in assessments:
                yield batch.verdicts[pair]
                continue
            case = replace(
                batch.case(pair, assessments[pair]),
                forced=others.forced.get(pair),
                lock=others.locked.get(pair),
                refused=others.refused.get(pair),
                reunion=others.reunions.get(pair),
                corroborated=corroborated.get(pair),
                together=components.together(*pair),
            )
            yield case.verdict()
