"""The robust method: from maps to a verdict for every pair of runs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from ...topology.errors import UsageError
from ...topology.topomap import TopoMap
from ..discards import Names
from ..locks import Lock, lock_table
from ..result import Alignment, PairVerdict, pairs_of
from .across import Across
from .alignment import Candidate, match
from .assessment import thresholds
from .batch import Batch, wanted_pairs
from .components import Components, Refusal, as_alignment, join_all
from .entries import Case
from .forced import forced_alignment
from .pairing import Means, Pair, Pairwise
from .prepare import Prepared
from .rematching import Rematcher, Reunion
from .settings import DEFAULT_ROBUST, RobustSettings
from .verdict import Assessment


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
    prepared, say = matcher.prepared, matcher.means.say
    locked = _locked_pairs(maps, locks)
    gone = _taken_back(maps, discarded)

    def alone(pair: Pair, view: Assessment) -> PairVerdict:
        i, j = pair
        return Case(prepared[i], prepared[j], view).verdict()

    thresholds_of = partial(
        thresholds,
        prepared,
        settings,
        with_themselves=matcher.with_themselves(),
    )
    batch = Batch(matcher, thresholds_of, alone, frozenset(locked))
    wanted = wanted_pairs(matcher, [*locked, *gone])
    say(f"{len(maps)} maps, {len(wanted)} of {pairs_of(len(maps))} pairs to match")
    batch.look_at(wanted, gone)
    forced = _forced(prepared, locked, batch.assessments, settings)
    never = [pair for pair, lock in locked.items() if lock.decision == "never"]
    components = Components(len(maps), never)
    best, order = _strongest_first(batch, forced)
    across = Across(
        prepared,
        matcher.places,
        best,
        other=batch.of_other_size(),
        asked=batch.asked_for_copies(),
        answers=batch.same_place_bits,
        locked=forced,
        most_sigmas=settings.size_sigmas,
    )
    names = [m.run for m in maps]
    refused = join_all(components, order, best, matcher.places, names, refusal=across.refusal)
    kept = {pair: found for pair, found in best.items() if pair not in refused}
    rematcher = Rematcher(
        maps,
        prepared,
        components,
        batch.undecided(),
        batch.threshold,
        settings,
        frozenset(gone),
        {
            pair: lock.at
            for pair, lock in locked.items()
            if lock.at is not None and lock.decision == "same" and pair not in forced
        },
        matcher.means.kept,
    )
    reunions = rematcher.run(kept)
    say(f"{len(kept)} pairs join, {len(reunions)} by what components say together")
    refused |= batch.look_again(components, reunions)
    said = Others(forced, locked, refused, reunions)
    return tuple(_verdicts(batch, components, said))


def _taken_back(maps: Sequence[TopoMap], discarded: Collection[Names]) -> list[Pair]:
    """The discarded matches of these maps, by indices."""
    row = {m.run: k for k, m in enumerate(maps)}
    return [(row[a], row[b]) for a, b in sorted(discarded) if a in row and b in row]


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


def _forced(
    prepared: Sequence[Prepared],
    locked: dict[Pair, Lock],
    views: Mapping[Pair, Assessment],
    settings: RobustSettings,
) -> dict[Pair, Candidate]:
    """Alignments of the pairs that are locked as the same: as they are shown to who locks them,
    also where copies are ranked otherwise than by chance."""
    out = {}
    for (i, j), lock in sorted(locked.items()):
        if lock.decision == "same":
            shown = (candidate for candidate, _ in views[i, j].ranked)
            candidates = (*shown, *match(prepared[i], prepared[j], settings))
            found = forced_alignment(prepared[i], prepared[j], candidates, lock, settings)
            if found is not None:
                out[i, j] = found
    return out


def _strongest_first(
    batch: Batch, forced: Mapping[Pair, Candidate]
) -> tuple[dict[Pair, Alignment], list[Pair]]:
    """The alignments to join by, and their order: locks first, then by evidence.

    A pair locked as the same is joined as the lock says or, if that is infeasible, not at all.
    """
    best = {pair: v.best for pair, v in batch.joins.items() if v.best is not None}
    bits = {pair: batch.joins[pair].evidence_bits for pair in best}
    best |= {pair: as_alignment(c) for pair, c in forced.items()}
    bits |= {pair: batch.assessments[pair].bits for pair in forced}
    order = sorted(best, key=lambda p: (p not in forced, -bits[p], p))
    return best, order


@dataclass(frozen=True, slots=True, eq=False)
class Others:
    """Locks, refusals and component matches of some pairs."""

    forced: Mapping[Pair, Candidate]
    locked: Mapping[Pair, Lock]
    refused: Mapping[Pair, Refusal]
    reunions: Mapping[Pair, Reunion]

    def of(self, pair: Pair) -> bool:
        """Whether there is any of a pair."""
        return any(pair in of for of in (self.forced, self.locked, self.refused, self.reunions))


def _verdicts(batch: Batch, components: Components, said: Others) -> Iterator[PairVerdict]:
    """The verdicts on all pairs that were matched, sorted.

    A verdict from the two maps alone stands unless a lock, a component or other runs concern the
    pair (`said`). For those, the candidates are read again, placements that other runs
    corroborate are added, and the verdict is computed with them.
    """
    prepared = batch.matcher.prepared
    pairs = sorted(batch.found)
    held = {pair: v for pair, v in (batch.joins | batch.alone).items() if not said.of(pair)}
    asked = [pair for pair in pairs if pair not in batch.joins or pair not in held]
    second = batch.corroborated(asked, components)
    held = {pair: v for pair, v in held.items() if pair not in second}
    told = batch.views([p for p in pairs if p not in held and p not in batch.assessments])
    views = {pair: view for pair, (view, _) in told.items()} | batch.assessments
    views |= batch.beside_rivals({pair: views[pair] for pair in told if pair in batch.joins})
    candidates = {pair: found for pair, (_, found) in told.items()}
    candidates |= batch.candidates([pair for pair in second if pair in batch.assessments])
    for pair in pairs:
        if pair in held:
            yield held[pair]
            continue
        i, j = pair
        yield Case(
            prepared[i],
            prepared[j],
            views[pair],
            forced=said.forced.get(pair),
            lock=said.locked.get(pair),
            refused=said.refused.get(pair),
            reunion=said.reunions.get(pair),
            corroborated=candidates[pair][second[pair]] if pair in second else None,
            together=components.together(i, j),
        ).verdict()
