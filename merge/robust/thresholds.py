"""The thresholds that the pairs of a batch must reach."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Protocol

import numpy as np

from ...topology.connected import connected
from ..result import pairs_of
from .alignment import Candidate
from .pairing import Pair
from .prepare import Prepared
from .repetition import CopyModel, copy_model
from .settings import MATCH, RobustSettings
from .verdict import Threshold, needed_bits, threshold_for, uniformity

ANY = -1
"""The group of buildings of a map whose own group has too few maps: all maps."""

LARGE_PART = 0.25
"""Least share of a map's junctions in a copy of a large part, of a wing rather than a standard
part. Of maps of 36 junctions half the offices and three quarters of the rows have one, a tenth of
the tunnels of standard parts (`benchmarks/aliasing.py`)."""

SHOWN = (0.25, 1.9)
"""Likelihood ratios of a building without against one with repeats, if a map shows a copy of a
large part of itself, and if it does not. .1 of tunnels show one, .4 and more of offices and
rows; .95 and .5 do not."""

BEFORE = (0.5, 3.0)
"""Prior, as numbers of buildings without and with copies that were seen before: two runs alone do
not show their kind of building. With 1.5 in place of 3 two offices of one design are merged, 10.0
of 9.97 bits."""


class ThresholdOf(Protocol):
    """Gives the threshold of some maps of a batch."""

    def __call__(self, maps: Sequence[int], pairs: int | None = None) -> Threshold:
        """maps: two, or those of two components; pairs: number of pairs that share the rate of
        false merges, by default all of the batch, including those screened out."""
        ...


def thresholds(
    prepared: Sequence[Prepared],
    settings: RobustSettings,
    against_chance: Mapping[Pair, float],
    self_matches: Sequence[tuple[Candidate, ...]],
) -> ThresholdOf:
    """The thresholds in a batch of maps.

    How a building repeats itself is estimated from the maps of like buildings: a folder may mix
    offices, all of whose maps repeat themselves, with mazes, none of which do. Maps that are
    connected by placements better than chance are of like buildings, unless they are too few.
    against_chance: evidence of the best placement of every pair that was matched [bits];
    self_matches: of each map with other parts of itself.
    """
    linked = {pair: bits for pair, bits in against_chance.items() if bits > MATCH.lead_bits}
    evidence = np.array(list(against_chance.values()))
    like = _like_buildings(len(self_matches), linked, settings)
    copies = [list(filter(_beyond_chance, found)) for found in self_matches]
    copied = _copied(copies, like, settings)
    unrepeated = _unrepeated_bits(prepared, copies, linked, settings)

    @cache
    def copies_in(groups: frozenset[int]) -> CopyModel:
        """How the buildings of some groups, by `_like_buildings`, repeat themselves."""
        maps = (k for k in range(len(self_matches)) if ANY in groups or like[k] in groups)
        samples = [(prepared[k], c) for k in maps for c in self_matches[k]]
        return copy_model([(m, c) for m, c in samples if c.bits > MATCH.lead_bits], settings)

    @cache  # few differ: most maps of like buildings have the same `copied`
    def cached(groups: frozenset[int], pairs: int, size: float, unrepeated: float) -> Threshold:
        beyond = int(np.count_nonzero(evidence >= needed_bits(pairs, settings)))
        model = copies_in(groups)
        return threshold_for(
            pairs, beyond, model, settings, copied=size, unrepeated_bits=unrepeated
        )

    def threshold(maps: Sequence[int], pairs: int | None = None) -> Threshold:
        count = pairs_of(len(prepared)) if pairs is None else pairs
        size, bits = max(copied[k] for k in maps), min(unrepeated[k] for k in maps)
        return cached(frozenset(like[k] for k in maps), count, size, bits)

    return threshold


def _like_buildings(maps: int, linked: Iterable[Pair], settings: RobustSettings) -> list[int]:
    """The group of like buildings of each of so many maps: its connected component in the graph of
    `linked` pairs, or `ANY` if that has too few maps for the `copied_share` quantile. Without `ANY`
    37 of 390 pairs of symmetric buildings are merged wrongly, 26 with it
    (`benchmarks/adversaries.py --only turned`)."""
    first, second = np.array([*linked], np.int64).reshape(-1, 2).T
    number = connected(first, second, maps)
    too_few = np.bincount(number) * (1 - settings.copied_share) < 1
    like: list[int] = np.where(too_few[number], ANY, number).tolist()
    return like


def _copied(
    copies_of_maps: Sequence[Sequence[Candidate]], like: Sequence[int], settings: RobustSettings
) -> list[float]:
    """Number of junctions of every map's largest copy of a part of itself, at least the
    `copied_share` quantile of the maps of like buildings; inf where the copy may extend beyond the
    map. copies_of_maps: of parts of each map; like: by `_like_buildings`."""
    sizes: dict[int, list[int]] = defaultdict(list)
    for building, copies in zip(like, copies_of_maps, strict=True):
        for group in {building, ANY}:
            sizes[group].append(max(map(len, copies), default=0))
    least = {group: float(np.quantile(n, settings.copied_share)) for group, n in sizes.items()}
    need_bits = needed_bits(1, settings)
    return [
        max([least[building], *(np.inf if _goes_on(c, need_bits) else len(c) for c in copies)])
        for building, copies in zip(like, copies_of_maps, strict=True)
    ]


def _unrepeated_bits(
    prepared: Sequence[Prepared],
    copies_of_maps: Sequence[Sequence[Candidate]],
    linked: Mapping[Pair, float],
    settings: RobustSettings,
) -> list[float]:
    """For every map the evidence [bits, 0 or more] that its building, though of few lengths, does
    not repeat itself.

    Buildings are the groups of maps connected by alignments beyond chance. A map without a copy of
    a large part of itself is evidence for it, one with a copy against it (`SHOWN`). The share of
    other buildings of few lengths that repeat themselves is the prior, estimated with `BEFORE`.
    copies_of_maps: as in `_copied`.
    """
    need = needed_bits(pairs_of(len(prepared)), settings)
    certain = [pair for pair, bits in linked.items() if bits >= need]
    first, second = np.array(certain, np.int64).reshape(-1, 2).T
    building = connected(first, second, len(prepared))
    size = np.array([len(m) for m in prepared])
    copy = np.array([max(map(len, copies), default=0) for copies in copies_of_maps])
    shows = copy >= np.maximum(LARGE_PART * size, 1)
    by_maps = np.bincount(building, np.log2(np.where(shows, *SHOWN)))
    members = [np.flatnonzero(building == g).tolist() for g in range(len(by_maps))]
    uniform = np.array([uniformity(*(prepared[k] for k in rows)) for rows in members])
    repeats = uniform * (np.bincount(building, shows) > 0)
    others, repeating = uniform.sum() - uniform, repeats.sum() - repeats
    bits = by_maps + np.log2((others - repeating + BEFORE[0]) / (repeating + BEFORE[1]))
    of_maps: list[float] = np.maximum(bits, 0.0)[building].tolist()
    return of_maps


def _goes_on(copy: Candidate, need_bits: float) -> bool:
    """Whether a copy of a part of a map, beyond chance, may extend beyond the map.

    A run through one wing of a building and a corner of the next, identical one shows that the
    building repeats itself, but not how far: the copy is as large as the corner. A standard part,
    or a copy by chance, ends within the map, and what lies around contradicts it.
    """
    bits = copy.counted_bits * _distinct_share(copy)
    return bits >= need_bits and copy.contradicting_bits < MATCH.lead_bits


def _beyond_chance(copy: Candidate) -> bool:
    """Whether the evidence of a match of a map with itself, without duplicates, exceeds chance.

    The columns of a maze, equally far apart in all its rows, match themselves after half a turn. If
    that counts twice, 5 of 53 pairs of mazes that share a tenth are taken for copies.
    """
    once = (copy.bits + copy.tested_bits) * _distinct_share(copy)
    return once - copy.tested_bits > MATCH.lead_bits


def _distinct_share(copy: Candidate) -> float:
    """Share of the pairs in a match of a map with itself that are not duplicates. If half a turn
    exchanges two junctions, both pairs are the same: any rectangle is its own copy."""
    pairs = np.sort(np.column_stack([copy.a, copy.b]), axis=1)
    return len(np.unique(pairs, axis=0)) / len(pairs)
