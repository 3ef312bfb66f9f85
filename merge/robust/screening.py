"""Screening: which pairs of a batch are matched; in a large batch those that the index selects.

Results of the index are kept from merge to merge, so that only new maps are looked up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ..digests import DIGEST, digested
from ..packs import Kept, Kind, arrays_from_bytes, arrays_to_bytes
from ..result import pairs_of
from .index import Corridors, Probes
from .settings import RobustSettings
from .tasks import TASKS
from .verdict import needed_bits


@dataclass(frozen=True, slots=True)
class ScreeningSettings:
    """Screening of large batches."""

    most_pairs: int = 5000
    """Batches with more pairs are screened: 100 runs take some seconds without."""
    share: float = 0.6
    """Connected links must have this share of the bits that merging needs. With 0.75 still nothing
    was lost of 1,354 pairs of runs that matching all 79,800 pairs joins (`benchmarks/fleet.py
    --recall 400 --first 5000`). Of 692 pairs beyond chance, nearly all copies in offices, 29 are
    screened out (`--beyond 160 --first 5000`): these do not count among the pairs that share the
    threshold against copies, .06 bits."""

    @property
    def spare_bits(self) -> float:
        """Pairs that lack up to this are kept as well: in a batch of half as many pairs merging
        needs one bit less."""
        return self.share


SCREENING = ScreeningSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Chances:
    """Pairs i < j of maps (k, 2), sorted, with their evidence by the index (k,) [bits], where it is
    at least `least`."""

    pairs: IntArray
    bits: FloatArray
    least: float

    def likely(self, least: float) -> IntArray:
        """The pairs with at least so many bits."""
        return self.pairs[self.bits >= least]


def pairs_to_match(
    maps: Sequence[Probes],
    settings: RobustSettings,
    digests: Sequence[bytes] = (),
    kept: Kept | None = None,
) -> IntArray:
    """(k, 2) pairs i < j, sorted: all of a small batch, of a large one those that the index
    selects.

    kept: earlier results, by the digests of the maps.
    """
    pairs = pairs_of(len(maps))
    if pairs <= SCREENING.most_pairs:
        return np.stack(np.triu_indices(len(maps), 1), axis=1)
    least = SCREENING.share * needed_bits(pairs, settings)
    if kept is None or len(set(digests)) < len(digests):
        return chances(maps, least).likely(least)
    return _known_chances(maps, least, digests, kept).likely(least)


def chances(maps: Sequence[Probes], least: float, known: IntArray | None = None) -> Chances:
    """The evidence by the index of all pairs except those of two known maps. O(links of the pairs).

    known: indices of maps, ascending. The pair (i, j) is looked up with map i; the result differs
    from (j, i) only in the direction of corridors.
    """
    old = np.zeros(0, np.int64) if known is None else known
    new = np.setdiff1d(np.arange(len(maps)), old)
    parts = [
        *_looked_up(maps, np.arange(len(maps)), new, least),
        *_looked_up(maps, new, old, least),
    ]
    pairs = np.concatenate([*(rows for rows, _ in parts), np.zeros((0, 2), np.int64)])
    return _sorted(pairs, np.concatenate([*(bits for _, bits in parts), np.zeros(0)]), least)


def _looked_up(
    maps: Sequence[Probes], first: IntArray, second: IntArray, least: float
) -> Iterator[tuple[IntArray, FloatArray]]:
    """Pairs i < j of the first and of the second maps, with their evidence."""
    for start in range(0, len(second), TASKS.at_hand):
        some = second[start : start + TASKS.at_hand]
        block = Corridors.of([maps[k] for k in some.tolist()])
        before = first[first < some[-1]]
        step = max(TASKS.at_hand // len(some), 1)  # of one new map all others are asked at once
        for k in range(0, len(before), step):
            own = before[k : k + step]
            after = np.searchsorted(some, own, side="right") - 1
            bits = block.chances([maps[i] for i in own.tolist()], least, after)
            row, found = np.nonzero(bits >= least)
            yield np.stack([own[row], some[found]], axis=1), bits[row, found]


def _sorted(pairs: IntArray, bits: FloatArray, least: float) -> Chances:
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return Chances(pairs[order], bits[order], least)


# --- kept -----------------------------------------------------------------------------------------


def _known_chances(
    maps: Sequence[Probes], least: float, digests: Sequence[bytes], kept: Kept
) -> Chances:
    """The evidence of all pairs, as far as it is not kept looked up now."""
    whole = digested(*digests)
    data = kept.find(Kind.CHANCES, (whole, whole))
    tables = kept.every(Kind.CHANCES) if data is None else iter([data])
    found = (_of_maps(table, digests, least) for table in tables)
    best = max((f for f in found if f is not None), key=lambda f: len(f[0]), default=None)
    if best is None:
        best = np.zeros(0, np.int64), Chances(np.zeros((0, 2), np.int64), np.zeros(0), least)
    known, out = best
    if data is None:
        more = chances(maps, least - SCREENING.spare_bits if not len(known) else out.least, known)
        pairs = np.concatenate([out.pairs, more.pairs])
        out = _sorted(pairs, np.concatenate([out.bits, more.bits]), more.least)
        kept.add(Kind.CHANCES, (whole, whole), _to_bytes(out, digests))
    return out


def _to_bytes(found: Chances, digests: Sequence[bytes]) -> bytes:
    names = np.frombuffer(b"".join(digests), "<i8")
    return arrays_to_bytes([np.array([found.least]), names, found.pairs, found.bits])


def _of_maps(
    data: bytes, digests: Sequence[bytes], least: float
) -> tuple[IntArray, Chances] | None:
    """The maps that a payload covers, ascending, and its evidence of their pairs; None if it is
    insufficient or orders the maps differently."""
    arrays = arrays_from_bytes(data, "fiif")
    if arrays is None:
        return None
    lowest, names, flat, bits = arrays
    if len(lowest) != 1 or lowest[0] > least or len(names) % 2 or len(flat) != 2 * len(bits):
        return None
    table, pairs = names.astype("<i8").tobytes(), flat.reshape(-1, 2)
    row = {table[k : k + DIGEST]: k // DIGEST for k in range(0, len(table), DIGEST)}
    if ((pairs < 0) | (pairs >= max(len(row), 1))).any() or 2 * len(row) != len(names):
        return None
    rows = np.array([row.get(digest, -1) for digest in digests], np.int64)
    known = np.flatnonzero(rows >= 0)
    if (np.diff(rows[known]) <= 0).any():
        return None
    number = np.full(len(row) + 1, -1)
    number[rows[known]] = known
    pairs = number[pairs]
    floor = max(float(lowest[0]), least - SCREENING.spare_bits)
    there = (pairs >= 0).all(axis=1) & (bits >= floor)
    return known, _sorted(pairs[there], bits[there], floor)
