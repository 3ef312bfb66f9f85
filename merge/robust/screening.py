"""Which pairs of a batch are matched: in a large one those to which the index gives a chance.

What the index says of two maps is kept from merge to merge, so that only new maps are looked up.
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
    """Which pairs of a large batch are matched at all."""

    most_pairs: int = 5000
    """Of more pairs only those are matched that have a chance: 100 runs take some seconds
    without."""
    share: float = 0.6
    """Links that hang together must have this share of the bits that merging needs. With 0.75 still
    nothing was lost of 1,354 pairs of runs that matching all 79,800 pairs joins
    (`benchmarks/fleet.py --recall 400 --first 5000`). Of 692 pairs beyond chance, nearly all copies
    in offices, the index gives 29 no chance (`--beyond 160 --first 5000`): these do not count among
    the pairs that share the second question, .06 bits."""

    @property
    def spare_bits(self) -> float:
        """Pairs that lack so much are kept, too: of a batch of half as many pairs merging needs a
        bit less."""
        return self.share


SCREENING = ScreeningSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Chances:
    """(k, 2) pairs i < j of maps, sorted, with (k,) what the index gives them, as far as that is no
    less than `least`."""

    pairs: IntArray
    bits: FloatArray
    least: float

    def likely(self, least: float) -> IntArray:
        """The pairs that have as much."""
        return self.pairs[self.bits >= least]


def pairs_to_match(
    maps: Sequence[Probes],
    settings: RobustSettings,
    digests: Sequence[bytes] = (),
    kept: Kept | None = None,
) -> IntArray:
    """(k, 2) pairs i < j, sorted: all of a small batch, of a large one those with a chance.

    kept, by the digests of the maps: what is known of that.
    """
    pairs = pairs_of(len(maps))
    if pairs <= SCREENING.most_pairs:
        return np.stack(np.triu_indices(len(maps), 1), axis=1)
    least = SCREENING.share * needed_bits(pairs, settings)
    if kept is None or len(set(digests)) < len(digests):
        return chances(maps, least).likely(least)
    return _known_chances(maps, least, digests, kept).likely(least)


def chances(maps: Sequence[Probes], least: float, known: IntArray | None = None) -> Chances:
    """What the index gives all pairs but those of two maps that are known. O(links of the pairs).

    known: numbers of maps, ascending. Which of two maps is looked up makes no difference but for
    which of both directions of a corridor is; the first one is.
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
    """Pairs i < j of the first and of the second maps, with what the index gives them."""
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
    """What is known of the maps, and of the others what the index says."""
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
    """Those of some maps that a payload knows, ascending, and what it says of their pairs; None
    where it says too little, or has them in another order."""
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
