"""Merging: from maps to verdicts, components and one fused map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from ..topology.errors import DataError
from ..topology.topomap import TopoMap
from ..topology.wording import listed
from . import robust
from .fusion.fuse import fuse
from .fusion.turning_ends import with_turning_ends
from .fusion.uncertainty import VAGUE_M, VAGUE_RAD
from .locks import DISCARDED, Lock, Names
from .paper import method as paper
from .paper.method import DEFAULT_PAPER, PaperSettings
from .result import (
    MOST_PAIRS,
    Component,
    MergeResult,
    PairVerdict,
    UnlistedPairs,
    Verdict,
    home_of,
    pairs_of,
)
from .robust import DEFAULT_ROBUST, Means, RobustSettings
from .through import joined_through
from .wording import describe_placement


@dataclass(frozen=True, slots=True)
class MergeSettings:
    """The method and its settings."""

    method: Literal["robust", "paper"] = "robust"
    """robust: tolerant matching with evidence in bits; paper: Huang & Beevers as published."""
    robust: RobustSettings = DEFAULT_ROBUST
    paper: PaperSettings = DEFAULT_PAPER


DEFAULT_MERGE = MergeSettings()

VIEWS_LOST = (
    "the views of run {run!r} are lost or damaged: it was merged by its junctions alone; ingest "
    "its log again"
)
"""Warns of what a merge had to do without."""

ALONE = "; the two maps alone: "
"""In the reasons of pairs joined by others, precedes their own verdict."""


def merge_maps(
    maps: Sequence[TopoMap],
    settings: MergeSettings = DEFAULT_MERGE,
    *,
    locks: Sequence[Lock] = (),
    discarded: Collection[Names] = (),
    means: Means | None = None,
) -> MergeResult:
    """Merge the maps of many runs: a verdict for every pair, components, one fused map.

    locks: the user's decisions on pairs; discarded: pairs of runs, in the order of names, whose
    matches the user discarded; means: where pairs are matched, and known results. The result
    depends neither on these means nor on the order of the maps. Raises DataError if two maps are of
    the same run, or one is in pieces (`pieces.joined_pieces`).
    """
    ordered = _sorted_by_run(maps)
    means = means or Means()
    verdicts = _decided(ordered, settings, locks, discarded, means)
    shown = _worth_listing(len(ordered), verdicts, discarded)
    components, fused = fuse(ordered, verdicts, sigmas=True, kept=means.kept)
    fused = with_turning_ends(fused, components, ordered)
    placed = _with_placements(shown, components)
    same = _same_recordings(ordered, means.kept.digest)
    warnings = [*same, *(VIEWS_LOST.format(run=m.run) for m in ordered if m.views_lost)]
    return MergeResult(
        components,
        fused,
        placed,
        info=_info(settings, components, placed, warnings),
        unlisted=_unlisted(len(ordered), verdicts, shown, components),
    )


def _sorted_by_run(maps: Sequence[TopoMap]) -> list[TopoMap]:
    """The maps sorted by run; DataError if two are of the same run, or one is in pieces."""
    count = Counter(m.run for m in maps)
    twice = sorted(run for run, times in count.items() if times > 1)
    if twice:
        raise DataError(
            f"run {twice[0]!r} is given {count[twice[0]]} times; every map needs a run name of "
            "its own: rename one of the logs and ingest it again"
        )
    for m in maps:
        if m.pieces > 1:
            raise DataError(
                f"the map of run {m.run!r} is in {m.pieces} pieces that share no frame, as "
                "its odometry broke; ingest its log again, or join them by joined_pieces()"
            )
    return sorted(maps, key=lambda m: m.run)


def _decided(
    maps: Sequence[TopoMap],
    settings: MergeSettings,
    locks: Sequence[Lock],
    discarded: Collection[Names],
    means: Means,
) -> tuple[PairVerdict, ...]:
    """The verdicts of the chosen method; `maps` are sorted by run."""
    if settings.method == "robust":
        return robust.decide(maps, settings.robust, locks=locks, discarded=discarded, means=means)
    with means.workers.start() if means.workers else nullcontext() as executor:
        verdicts = paper.decide(
            maps, settings.paper, locks=locks, on_pair=means.on_pair, executor=executor
        )
    return tuple(_taken_back(v) if (v.a, v.b) in discarded else v for v in verdicts)


def _taken_back(verdict: PairVerdict) -> PairVerdict:
    """The verdict on a pair whose match was discarded; a lock takes precedence."""
    if verdict.locked:
        return verdict
    need = verdict.threshold_bits
    return PairVerdict(
        verdict.a, verdict.b, Verdict.UNRELATED, False, 0.0, DISCARDED, threshold_bits=need
    )


def _worth_listing(
    runs: int, verdicts: tuple[PairVerdict, ...], discarded: Collection[Names]
) -> tuple[PairVerdict, ...]:
    """The verdicts to list: all of a small merge, of a large one those with any evidence."""
    if pairs_of(runs) <= MOST_PAIRS:
        return verdicts
    return tuple(
        v
        for v in verdicts
        if v.verdict is not Verdict.UNRELATED or v.locked or (v.a, v.b) in discarded
    )


def _unlisted(
    runs: int,
    verdicts: tuple[PairVerdict, ...],
    shown: tuple[PairVerdict, ...],
    components: Sequence[Component],
) -> UnlistedPairs | None:
    """Counts of the pairs of a large merge that are not listed."""
    if pairs_of(runs) <= MOST_PAIRS:
        return None
    home = home_of(components)
    joined = sum(pairs_of(len(c.poses)) for c in components)
    joined -= sum(home[v.a] == home[v.b] for v in shown)
    apart = [v for v in verdicts if home[v.a] != home[v.b]]
    unrelated = len(apart) - sum(home[v.a] != home[v.b] for v in shown)
    screened = pairs_of(runs) - len(shown) - joined - unrelated
    return UnlistedPairs(joined=joined, unrelated=unrelated, screened=screened)


def _with_placements(
    verdicts: tuple[PairVerdict, ...], components: Sequence[Component]
) -> tuple[PairVerdict, ...]:
    """The verdicts, with the uncertainty of the relative pose of pairs of one component, and for
    those that only others join, through which runs."""
    home = {run: c for c in components for run in c.poses}
    chains = joined_through(verdicts)
    of: dict[int, list[Names]] = {}
    for v in verdicts:
        if v.accepted or (v.a, v.b) in chains:
            of.setdefault(home[v.a].id, []).append((v.a, v.b))
    sigmas: dict[Names, tuple[float, float]] = {}
    for c in components:
        pairs = of.get(c.id, [])
        if pairs and c.spread is not None:
            sigmas.update(zip(pairs, c.spread.sigmas(pairs), strict=True))
    return tuple(_placed(v, chains.get((v.a, v.b)), sigmas.get((v.a, v.b))) for v in verdicts)


def _placed(
    v: PairVerdict, through: tuple[str, ...] | None, placed: tuple[float, float] | None
) -> PairVerdict:
    """A verdict with the chain of runs that joins the two, and how surely they are placed."""
    if v.accepted:
        return v if placed is None else replace(v, transform_sigma=placed)
    if through is None:
        return v
    description = f"joined through {listed(through, 3)}"
    if placed is not None:
        vague = placed[0] > VAGUE_M or placed[1] > VAGUE_RAD
        description = (
            f"{description}, placed to {describe_placement(*placed)} (1 sigma)"
            f"{', too vaguely to count on it' if vague else ''}"
        )
    return replace(v, reason=f"{description}{ALONE}{v.reason}", through=through, placed=placed)


def _info(
    settings: MergeSettings,
    components: Sequence[Component],
    verdicts: Sequence[PairVerdict],
    warnings: list[str],
) -> dict[str, Any]:
    """The method, its settings, the layers (§4.1) around the first run of every component, and
    warnings."""
    home = home_of(components)
    inside: dict[int, list[PairVerdict]] = {}
    for v in verdicts:
        if v.accepted:
            inside.setdefault(home[v.a], []).append(v)
    firsts = {c.id: min(c.poses) for c in components if len(c.poses) > 1}
    own = settings.robust if settings.method == "robust" else settings.paper
    return {
        "settings": asdict(own),
        "method": settings.method,
        "layers": {first: _layers(first, inside[k]) for k, first in firsts.items()},
        **({"warnings": warnings} if warnings else {}),
    }


def _layers(own: str, accepted: Sequence[PairVerdict]) -> list[dict[str, Any]]:
    """JSON rows {"run", "layer", "depends_on"} of all runs connected to `own` by accepted verdicts,
    by layer, then by name (§4.1).

    Layer 0 is a run's own map, layer n + 1 holds the maps matched to maps of layer n. One that
    several of these match depends on the strongest of the matches.
    """
    rows: list[dict[str, Any]] = [{"run": own, "layer": 0, "depends_on": None}]
    placed, below = {own}, {own}
    while below:
        best: dict[str, tuple[float, str]] = {}
        for v in accepted:
            for run, base in ((v.a, v.b), (v.b, v.a)):
                if base in below and run not in placed:
                    rank = (-v.evidence_bits, base)
                    best[run] = min(best.get(run, rank), rank)
        layer = rows[-1]["layer"] + 1
        rows += [{"run": run, "layer": layer, "depends_on": best[run][1]} for run in sorted(best)]
        below = set(best)
        placed |= below
    return rows


def _same_recordings(maps: Sequence[TopoMap], digest: Callable[[TopoMap], bytes]) -> list[str]:
    """Warnings on runs whose maps are identical except for their names."""
    runs: dict[bytes, list[str]] = {}
    for m in maps:
        if len(m):
            runs.setdefault(digest(m), []).append(m.run)
    return [
        f"{listed(names)} are one recording under {len(names)} names: what it tells counts "
        f"{len(names)} times; discard all but one"
        for names in runs.values()
        if len(names) > 1
    ]
