"""The pairwise stage: results of earlier merges are looked up, other pairs are matched, here or by
workers (`tasks`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar, overload
from weakref import WeakKeyDictionary

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import DataError
from ...topology.files import Json
from ...topology.topomap import TopoMap
from ..digests import Digests, digested
from ..packs import Kept, Key, Kind, Pack, Store
from ..result import PairVerdict
from ..workers import Workers
from .alignment import Candidate
from .index import Probes
from .kept_verdicts import entry_text, held_text
from .mirror import mirrored
from .prepare import Extent, Prepared, prepare
from .records import from_bytes
from .repetition import CopyModel, copy_model
from .settings import RobustSettings
from .tasks import TASKS, Maps, MatchTask, era_of, match_task, matched, tile_order
from .verdict import Faint

Pair = tuple[int, int]
Remembered = TypeVar("Remembered", Probes, CopyModel)
Samples = Sequence[tuple[int, Candidate]]
"""Matches of maps of a batch with other parts of themselves: index of the map, candidate."""
T = TypeVar("T")
Read = Callable[[Pack, int, IntArray], T | None]
"""Reads a record of a pack: its row, and the pair that it belongs to."""


@dataclass(frozen=True, slots=True)
class Told:
    """The result of matching two maps, in short.

    faint: the best alignment if none is beyond chance; against_chance: see `Found`; full: whether
    any is beyond chance.
    """

    faint: Faint | None = None
    against_chance: float = 0.0
    full: bool = False


@dataclass(frozen=True, slots=True)
class Means:
    """How the pairs of a batch are matched, without influence on the results.

    workers: executors, this process if None; maps: where they find the maps, None to send them
    along; store: known results; on_pair(done, total): progress; tell: called with one line of text
    per event; verdict_keys: filled with the store's keys of verdicts of the batch.
    """

    workers: Workers | None = None
    maps: Maps | None = None
    store: Store | None = None
    on_pair: Callable[[int, int], None] | None = None
    tell: Callable[[str], None] | None = None
    digest: Digests = field(default_factory=Digests)
    verdict_keys: dict[PairVerdict, Key] = field(default_factory=dict)

    @property
    def kept(self) -> Kept | None:
        """The store's records, one by one."""
        return None if self.store is None else Kept(self.store, self.digest)

    def kept_entry(self, verdict: PairVerdict) -> Json | None:
        """The entry of a verdict in the merged document, if it is kept. Entries of new verdicts are
        read back, because holding all of them would take as much memory as the document."""
        key = self.verdict_keys.get(verdict)
        if key is None or self.store is None:
            return None
        if (text := held_text(verdict)) is not None:
            return text
        data = self.store.find(Kind.VERDICT, key)
        return None if data is None else entry_text(data)

    def say(self, text: str) -> None:
        """Report an event, if `tell` is given."""
        if self.tell is not None:
            self.tell(text)


class Lazily(Sequence[T]):
    """A sequence with items made on first access: most are never needed if results are known."""

    def __init__(self, count: int, made: Callable[[int], T]) -> None:
        self._count = count
        self._make = made
        self._made: dict[int, T] = {}

    @overload
    def __getitem__(self, k: int) -> T: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[T]: ...
    def __getitem__(self, k: int | slice) -> T | Sequence[T]:
        if isinstance(k, slice):
            return [self[row] for row in range(*k.indices(self._count))]
        if k not in self._made:
            if not 0 <= k < self._count:
                raise IndexError(k)
            self._made[k] = self._make(k)
        return self._made[k]

    def __len__(self) -> int:
        return self._count


class Pairwise:
    """The maps of a batch, sorted by run, for matching with each other."""

    def __init__(
        self, maps: Sequence[TopoMap], settings: RobustSettings, means: Means | None = None
    ) -> None:
        self.maps = maps
        self.settings = settings
        self.means = means or Means()
        self.prepared = Lazily(len(maps), lambda k: prepare(maps[k]))
        self.probes = Lazily(len(maps), self._probes)
        self.extents = [Extent.of(m) for m in maps]
        self.places = [m.xy[:, 0] + 1j * m.xy[:, 1] for m in maps]
        self.digests = [self.means.digest(m) for m in maps]
        self._row = {digest: k for k, digest in enumerate(self.digests)}
        number = {digest: k for k, digest in enumerate(self._row)}
        self._number = np.array([number[digest] for digest in self.digests], np.int64)
        self._images: dict[int, Prepared] = {}
        self._packs: list[Pack] = []
        # Of packs that still are: those that a store has written since are not held here.
        self._sorted: WeakKeyDictionary[Pack, dict[Kind, tuple[IntArray, IntArray]]]
        self._sorted = WeakKeyDictionary()
        if self.means.store is not None and self.means.store.era != era_of(settings):
            raise ValueError("what the store keeps is of other settings")

    def _probes(self, k: int) -> Probes:
        return self._remembered(
            Kind.PROBES,
            self.digests[k],
            lambda data: Probes.from_bytes(data, self.extents[k]),
            lambda: Probes.of(self.prepared[k]),
        )

    def _remembered(
        self,
        kind: Kind,
        digest: bytes,
        read: Callable[[bytes], Remembered | None],
        make: Callable[[], Remembered],
    ) -> Remembered:
        """The object kept under twice a digest; made, and kept, if none can be read."""
        kept, key = self.means.kept, (digest, digest)
        data = None if kept is None else kept.find(kind, key)
        found = None if data is None else read(data)
        if found is None:
            found = make()
            if kept is not None:
                kept.add(kind, key, found.to_bytes())
        return found

    def pairs(self, wanted: IntArray) -> list[Told]:
        """The result of matching each of (k, 2) pairs, in short."""
        return self._all(Kind.PAIR, wanted, _told, said=True)

    def candidates(self, wanted: IntArray) -> list[tuple[Candidate, ...]]:
        """The candidates of each of (k, 2) pairs; none where none is beyond chance."""
        return self._all(Kind.PAIR, wanted, self._candidates)

    def beside_rivals(self, wanted: IntArray) -> list[tuple[Candidate, ...]]:
        """The same including all other hypotheses beyond chance."""
        return self._all(Kind.RIVALS, wanted, self._candidates, said=True)

    def with_themselves(self) -> list[tuple[Candidate, ...]]:
        """Matches of every map with other parts of itself."""
        rows = np.arange(len(self.maps)).repeat(2).reshape(-1, 2)
        return self._all(Kind.ITSELF, rows, self._candidates, said=True)

    def copies(self, samples: Samples) -> CopyModel:
        """The copy model estimated from maps that match other parts of themselves."""
        return self._remembered(
            Kind.COPIES,
            digested(*(self.digests[k] for k in sorted({k for k, _ in samples}))),
            CopyModel.from_bytes,
            lambda: copy_model([(self.prepared[k], c) for k, c in samples], self.settings),
        )

    def image_bits(self, wanted: IntArray) -> dict[Pair, float]:
        """Evidence of the best alignment with the mirror image of each pair's second map [bits]."""
        told = self._all(Kind.IMAGE, wanted, _told, said=True)
        self._images.clear()  # .1 MB a map, and hardly asked for again
        pairs = ((i, j) for i, j in wanted.tolist())
        bits = (-np.inf if t.faint is None else t.faint.bits for t in told)
        return dict(zip(pairs, bits, strict=True))

    def _all(self, kind: Kind, wanted: IntArray, read: Read[T], *, said: bool = False) -> list[T]:
        """The record of each pair, in their order, decoded by `read`, which returns None if it
        cannot be of the pair. Unknown pairs are matched."""
        out: list[T | None] = [None] * len(wanted)
        done = 0

        def tell(more: int) -> None:
            nonlocal done
            done += more
            if kind is Kind.PAIR and said and more and self.means.on_pair is not None:
                self.means.on_pair(done, len(wanted))

        for pack, rows, places in self._known(kind, wanted):
            for row, place in zip(rows, places, strict=True):
                if out[place] is None:
                    out[place] = read(pack, row, wanted[place])
        tell(sum(found is not None for found in out))
        missing = np.array([k for k, found in enumerate(out) if found is None], np.int64)
        known = len(wanted) - len(missing)
        if said:
            self.means.say(f"{kind.told}: {len(wanted)}, of which {known} are known already")
        for chosen, pack in self._matched(kind, wanted, missing):
            for row, place in enumerate(chosen.tolist()):
                out[place] = read(pack, row, wanted[place])
            tell(len(chosen))
        return [_made(found) for found in out]

    def _known(self, kind: Kind, wanted: IntArray) -> Iterator[tuple[Pack, list[int], list[int]]]:
        """Known records for some of the pairs: each pack with its rows, and the positions of the
        pairs."""
        key = self._number[wanted[:, 0]] * len(self._row) + self._number[wanted[:, 1]]
        store = self.means.store
        for pack in self._packs if store is None else store.packs(self.digests):
            keys, rows = self._keys(kind, pack)
            if len(keys):
                at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
                places = np.flatnonzero(keys[at] == key)
                yield pack, rows[at[places]].tolist(), places.tolist()

    def _keys(self, kind: Kind, pack: Pack) -> tuple[IntArray, IntArray]:
        """The records of a pack of one kind and of maps of the batch: their pairs as numbers,
        ascending, and their rows."""
        known = self._sorted.setdefault(pack, {})
        if kind not in known:
            number = {digest: k for k, digest in enumerate(self._row)}
            to = np.array([number.get(d, -1) for d in pack.digests] or [-1], np.int64)
            a, b = to[pack.rows["a"]], to[pack.rows["b"]]
            rows = np.flatnonzero((a >= 0) & (b >= 0) & (pack.rows["kind"] == kind))
            keys = a[rows] * len(self._row) + b[rows]
            order = np.argsort(keys, kind="stable")
            known[kind] = keys[order], rows[order]
        return known[kind]

    def _candidates(self, pack: Pack, row: int, pair: IntArray) -> tuple[Candidate, ...] | None:
        """The candidates of a record; None if it cannot be of this pair."""
        if not pack.rows["size"][row]:
            return ()
        payload = pack.payload(row)
        if payload is None:
            return None
        return from_bytes(payload, *(self.extents[k] for k in pair.tolist()))

    def _matched(
        self, kind: Kind, wanted: IntArray, missing: IntArray
    ) -> Iterator[tuple[IntArray, Pack]]:
        """New results: the positions of pairs, and a pack with a record for each."""
        tasks = list(self._tasks(kind, wanted, missing))
        for k, pack in self._done([task for _, task in tasks]):
            if self.means.store is not None:
                self.means.store.keep(pack)
            else:
                self._packs.append(pack)
            yield tasks[k][0], pack

    def _done(self, tasks: list[MatchTask]) -> Iterator[tuple[int, Pack]]:
        workers, pairs = self.means.workers, sum(len(task.pairs) for task in tasks)
        if workers is None or len(tasks) < 2 or pairs < workers.worth:
            yield from ((k, match_task(task, self._ready)) for k, task in enumerate(tasks))
            return
        era = era_of(self.settings)
        for k, data in workers.results(matched, tasks):
            pack = Pack.from_bytes(data)
            if pack.era != era:
                raise DataError(
                    "a worker runs another version of topobatch, numpy or scipy than this "
                    "process: install the same on all machines"
                )
            yield k, pack

    def _ready(self, digest: bytes, image: bool) -> Prepared:
        k = self._row[digest]  # of several maps that are the same but for their names any will do
        if not image:
            return self.prepared[k]
        if k not in self._images:
            self._images[k] = prepare(mirrored(self.maps[k]))
        return self._images[k]

    def _tasks(
        self, kind: Kind, wanted: IntArray, missing: IntArray
    ) -> Iterator[tuple[IntArray, MatchTask]]:
        """The missing pairs tile by tile, with their positions."""
        order = missing[tile_order(wanted[missing])]
        size = min(TASKS.tile**2, max(-(-len(order) // TASKS.tile), 1))
        for start in range(0, len(order), size):
            places = order[start : start + size]
            maps, rows = np.unique(wanted[places], return_inverse=True)
            yield (
                places,
                MatchTask(
                    kind=kind,
                    runs=tuple((self.maps[k].run, self.digests[k]) for k in maps.tolist()),
                    pairs=rows.reshape(-1, 2),
                    settings=self.settings,
                    maps=self.means.maps,
                    sent={}
                    if self.means.maps is not None or self.means.workers is None
                    else {self.digests[k]: self.maps[k] for k in maps.tolist()},
                ),
            )


def _told(pack: Pack, row: int, _: IntArray) -> Told:
    """A record in short."""
    record = pack.rows[row]
    bits, against_chance = float(record["bits"]), float(record["beyond"])
    junctions, size = int(record["junctions"]), int(record["size"])
    faint = Faint(junctions, bits, against_chance) if junctions and not size else None
    return Told(faint, against_chance, size > 0)


def _made(found: T | None) -> T:
    if found is None:
        raise DataError("a worker sent results that cannot be of the maps that it was given")
    return found
