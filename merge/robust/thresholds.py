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
"""Stands for the connected component of a map of which the others are too few."""

LARGE_PART = 0.25
"""Share of a map's junctions from which on a copy within it is of a wing, not of a standard part:
of maps of 36 junctions half the offices and three quarters of the rows show one, a tenth of the
tunnels of standard parts (`benchmarks/aliasing.py`)."""

SHOWING = 12
"""Junctions from which on a map can show a copy of a large part of itself: of offices with so many
.43 do, of larger ones .6."""

SHOWN = (0.25, 1.9)
"""How much more often a map shows, or does not show, a copy of a large part of itself, if its
building does not repeat itself: .1 of tunnels, .4 and more of offices and rows; .95 and .5."""

BEFORE = (0.5, 3.0)
"""Buildings without and with copies that are taken to have been seen before: two runs alone tell
nothing of their kind. With 1.5 in place of 3 two offices of one design are merged, 10.0 of 9.97
bits."""


class ThresholdOf(Protocol):
    """Gives the threshold of some maps of a batch."""

    def __call__(self, some: Sequence[int], pairs: int | None = None) -> Threshold:
        """some: two maps, or the runs of two components; pairs: that share the rate of false
        merges, by default all of the batch, including those screened out."""
        ...


def thresholds(
    prepared: Sequence[Prepared],
    settings: RobustSettings,
    against_chance: Mapping[Pair, float],
    own: Sequence[tuple[Candidate, ...]],
) -> ThresholdOf:
    """The thresholds in a batch of maps.

    How a building repeats itself is estimated from the maps of buildings like it: a folder may mix
    offices, all of whose maps repeat themselves, with mazes, none of which do. Maps that chains of
    placements better than chance connect are of like buildings, unless they are too few to tell.
    against_chance: evidence of the best placement of every pair that was matched [bits]; own:
    matches of each map with other parts of itself.
    """
    linked = {pair: bits for pair, bits in against_chance.items() if bits > MATCH.lead_bits}
    evidence = np.array(list(against_chance.values()))
    like = _like_buildings(len(own), linked, settings)
    beyond = [list(filter(_beyond_chance, found)) for found in own]
    copied = _copied(beyond, like, settings)
    unrepeated = _unrepeated_bits(prepared, beyond, linked, settings)

    @cache
    def pairs_beyond(need: float) -> int:
        """Number of pairs with at least so much evidence against chance [bits]."""
        return int(np.count_nonzero(evidence >= need))

    @cache
    def copies(of: frozenset[int]) -> CopyModel:
        """How the maps of like buildings, by `_like_buildings`, repeat themselves."""
        maps = (k for k in range(len(own)) if ANY in of or like[k] in of)
        samples = ((prepared[k], c) for k in maps for c in own[k] if c.bits > MATCH.lead_bits)
        return copy_model(list(samples), settings)

    @cache  # few differ: no map has less copied than most of those of like buildings
    def reached(of: frozenset[int], pairs: int, most: float, unlike: float) -> Threshold:
        odd = pairs_beyond(needed_bits(pairs, settings))
        return threshold_for(pairs, odd, copies(of), settings, copied=most, unrepeated_bits=unlike)

    def threshold(some: Sequence[int], pairs: int | None = None) -> Threshold:
        count = pairs_of(len(prepared)) if pairs is None else pairs
        most, unlike = max(copied[k] for k in some), min(unrepeated[k] for k in some)
        return reached(frozenset(like[k] for k in some), count, most, unlike)

    return threshold


def _like_buildings(maps: int, linked: Iterable[Pair], settings: RobustSettings) -> list[int]:
    """For each of so many maps the number of its connected component in the graph of `linked`
    pairs; `ANY` if the component has too few maps for the `copied_share` quantile, beyond which not
    a single one would lie: 37 of 390 pairs of symmetric buildings are merged wrongly without that,
    26 with it (`benchmarks/adversaries.py --only turned`)."""
    one, other = np.array([*linked], np.int64).reshape(-1, 2).T
    number = connected(one, other, maps)
    few = np.bincount(number) * (1 - settings.copied_share) < 1
    like: list[int] = np.where(few[number], ANY, number).tolist()
    return like


def _copied(
    beyond: Sequence[Sequence[Candidate]],
    like: Sequence[int],
    settings: RobustSettings,
) -> list[float]:
    """Number of junctions of every map's largest copy of a part of itself, at least the
    `copied_share` quantile of the maps of like buildings; inf where the copy may extend beyond the
    map. beyond: copies of parts of each map, better than chance; like: as by `_like_buildings`."""
    seen: dict[int, list[int]] = defaultdict(list)
    for building, own in zip(like, beyond, strict=True):
        for of in {building, ANY}:
            seen[of].append(max(map(len, own), default=0))
    least = {of: float(np.quantile(most, settings.copied_share)) for of, most in seen.items()}
    need = needed_bits(1, settings)
    return [
        max([least[building], *(np.inf if _goes_on(c, need) else len(c) for c in own)])
        for building, own in zip(like, beyond, strict=True)
    ]


def _unrepeated_bits(
    prepared: Sequence[Prepared],
    beyond: Sequence[Sequence[Candidate]],
    linked: Mapping[Pair, float],
    settings: RobustSettings,
) -> list[float]:
    """For every map the evidence [bits, 0 or more] that its building, though of few lengths, does
    not repeat itself.

    Buildings are the groups of maps with alignments that chance does not explain. A map that finds
    no copy of a large part of itself speaks for it, by `SHOWN`; one that does speaks against it. So
    do other buildings of few lengths: their share is estimated as if `BEFORE` had been seen.
    beyond: as in `_copied`.
    """
    need = needed_bits(pairs_of(len(prepared)), settings)
    sure = [pair for pair, bits in linked.items() if bits >= need]
    one, other = np.array(sure, np.int64).reshape(-1, 2).T
    building = connected(one, other, len(prepared))
    size = np.array([len(m) for m in prepared])
    copy = np.array([max(map(len, own), default=0) for own in beyond])
    shows, large = copy >= LARGE_PART * size, size >= SHOWING
    told = np.where(large, np.log2(np.where(shows, *SHOWN)), 0.0)
    own = np.bincount(building, told)
    runs = [np.flatnonzero(building == g).tolist() for g in range(len(own))]
    uniform = np.array([uniformity(*(prepared[k] for k in of)) for of in runs])
    repeats = uniform * (np.bincount(building, shows & large) > 0)
    others, repeating = uniform.sum() - uniform, repeats.sum() - repeats
    bits = own + np.log2((others - repeating + BEFORE[0]) / (repeating + BEFORE[1]))
    out: list[float] = np.maximum(bits, 0.0)[building].tolist()
    return out


def _goes_on(copy: Candidate, need_bits: float) -> bool:
    """Whether a copy of a part of a map that chance does not explain may end only where the run
    ended.

    A run through one wing of a building and a corner of the next, identical one has shown that the
    building repeats itself, but not how far: the copy is as large as the corner. A standard part,
    or a copy by chance, ends, and what lies beyond contradicts it.
    """
    bits = copy.counted_bits * _distinct_share(copy)
    return bits >= need_bits and copy.contradicting_bits < MATCH.lead_bits


def _beyond_chance(copy: Candidate) -> bool:
    """Whether the evidence of a match of a map with itself, without duplicates, exceeds chance.

    The columns of a maze, equally far apart in all its rows, match themselves after half a turn;
    counting that twice, 5 of 53 pairs of mazes that share a tenth are taken for copies.
    """
    once = (copy.bits + copy.tested_bits) * _distinct_share(copy)
    return once - copy.tested_bits > MATCH.lead_bits


def _distinct_share(copy: Candidate) -> float:
    """Share of the evidence of a match of a map with itself that is not a duplicate. If half a turn
    exchanges two junctions, both matches state the same: any rectangle is its own copy."""
    pairs = np.sort(np.column_stack([copy.a, copy.b]), axis=1)
    return len(np.unique(pairs, axis=0)) / len(pairs)
