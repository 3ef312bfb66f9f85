"""The pairwise stage: what earlier merges found is looked up, the rest is matched, here or by
workers.

A task names maps by run and content digest; the worker reads them. Results come back as packs
whoever made them, so that one process, many, and a cache give the same numbers.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Protocol, TypeVar, overload

import numpy as np
import scipy
from numpy.typing import NDArray

from ...topology.errors import DataError
from ...topology.files import Json
from ...topology.topomap import TopoMap
from ..packs import DIGEST, Digests, Kept, Key, Kind, Pack, PackWriter, Store, digest_of, digested
from ..result import PairVerdict
from ..workers import Workers
from .alignment import Candidate, match_all, self_matches
from .index import Probes
from .kept_verdicts import entry_text
from .mirror import mirrored
from .prepare import Extent, Prepared, prepare
from .records import Found, from_bytes, in_short, to_bytes
from .repetition import CopyModel, copy_model
from .settings import DEFAULT_ROBUST, RobustSettings
from .verdict import Faint

Pair = tuple[int, int]
IntArray = NDArray[np.int64]
Remembered = TypeVar("Remembered", Probes, CopyModel)
Samples = Sequence[tuple[int, Candidate]]
"""Maps of a batch that look like other parts of themselves, by their numbers."""
Ready = Callable[[bytes, bool], Prepared]
"""The prepared map of a digest, or its mirror image."""


T = TypeVar("T")
Read = Callable[[Pack, int, IntArray], T | None]
"""Reads a record of a pack: its row, and the pair that it is of."""


@dataclass(frozen=True, slots=True)
class Told:
    """What matching two maps comes to. faint: the best alignment where none is beyond chance, None
    where there is none; against_chance: as `Found` has it; full: whether any is beyond chance."""

    faint: Faint | None = None
    against_chance: float = 0.0
    full: bool = False


class Maps(Protocol):
    """Where workers find the maps of runs."""

    def read_map(self, run: str) -> TopoMap:
        """The map of a run."""
        ...


@dataclass(frozen=True, slots=True)
class TaskSettings:
    """How pairs are divided among workers, which changes no result."""

    tile: int = 32
    """Maps per side of the tiles in which pairs are taken, and pairs of a task at most a tile: a
    map that is read serves a row of it, and asking for a second of work does not count. Into as
    many tasks even few pairs are divided, for the sake of several workers."""
    at_hand: int = 256
    """Maps that a worker remembers, and that the index looks through at once: some 100 kB each."""


TASKS = TaskSettings()


@dataclass(frozen=True, slots=True)
class Means:
    """How the pairs of a batch are matched, which changes no result. workers: who does it, this
    process if None; maps: where they find the maps, None to send them along; store: what is known
    already; on_pair(done, total): told of progress; tell: told what happens, a line at a time;
    verdict_keys: where the store keeps verdicts of the batch."""

    workers: Workers | None = None
    maps: Maps | None = None
    store: Store | None = None
    on_pair: Callable[[int, int], None] | None = None
    tell: Callable[[str], None] | None = None
    digest: Digests = field(default_factory=Digests)
    verdict_keys: dict[PairVerdict, Key] = field(default_factory=dict)

    @property
    def kept(self) -> Kept | None:
        """What is known already, one by one."""
        return None if self.store is None else Kept(self.store, self.digest)

    def kept_entry(self, verdict: PairVerdict) -> Json | None:
        """The entry of a verdict in the merged document, where it is kept: read anew, for all of
        them together are as large as the document."""
        key = self.verdict_keys.get(verdict)
        if key is None or self.store is None:
            return None
        data = self.store.find(Kind.VERDICT, key)
        return None if data is None else entry_text(data)

    def say(self, text: str) -> None:
        """Tell what happens, if anybody listens."""
        if self.tell is not None:
            self.tell(text)


@dataclass(frozen=True, slots=True, eq=False)
class MatchTask:
    """Pairs to be matched. runs: name and digest of each map; pairs: (k, 2) rows of them; maps:
    where they are; sent: they themselves, by digest, where they are nowhere."""

    kind: Kind
    runs: tuple[tuple[str, bytes], ...]
    pairs: IntArray
    settings: RobustSettings
    maps: Maps | None = None
    sent: Mapping[bytes, TopoMap] = field(default_factory=dict)


def era_of(settings: RobustSettings) -> bytes:
    """Changes whenever results may: with the program, the libraries, the settings of matching."""
    told = asdict(replace(settings, false_merge_rate=DEFAULT_ROBUST.false_merge_rate))
    parts = [_program(), np.__version__, scipy.__version__, told]
    text = json.dumps(parts, sort_keys=True)
    return digested(text.encode())


@cache
def _program() -> str:
    """Digest of all code that matching can reach. A version number would have to be thought of."""
    root = Path(__file__).parents[2]
    out = hashlib.blake2b(digest_size=DIGEST)
    for folder in ("topology", "merge"):
        for path in sorted((root / folder).rglob("*.py")):
            out.update(path.relative_to(root).as_posix().encode())
            out.update(path.read_bytes())
    return out.hexdigest()


class Lazily(Sequence[T]):
    """Something of each of some maps, made when it is asked for: of many that are known already
    most never are."""

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
    """The maps of a batch, sorted by run, ready to be matched with each other."""

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
        self._sorted: dict[tuple[int, Kind], tuple[Pack, IntArray, IntArray]] = {}
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
        """What is kept under twice a digest; made, and kept, where none can be read."""
        kept, key = self.means.kept, (digest, digest)
        data = None if kept is None else kept.find(kind, key)
        found = None if data is None else read(data)
        if found is None:
            found = make()
            if kept is not None:
                kept.add(kind, key, found.to_bytes())
        return found

    def pairs(self, wanted: IntArray) -> list[Told]:
        """What matching each of (k, 2) pairs comes to, in short."""
        return self._all(Kind.PAIR, wanted, _told, said=True)

    def candidates(self, wanted: IntArray) -> list[tuple[Candidate, ...]]:
        """What it found, in full; nothing where that is all that chance would not offer."""
        return self._all(Kind.PAIR, wanted, self._candidates)

    def with_themselves(self) -> list[tuple[Candidate, ...]]:
        """Matches of every map with other parts of itself."""
        rows = np.arange(len(self.maps)).repeat(2).reshape(-1, 2)
        return self._all(Kind.ITSELF, rows, self._candidates, said=True)

    def copies(self, samples: Samples) -> CopyModel:
        """How copies differ by what some maps show of themselves."""
        return self._remembered(
            Kind.COPIES,
            digested(*(self.digests[k] for k in sorted({k for k, _ in samples}))),
            CopyModel.from_bytes,
            lambda: copy_model([(self.prepared[k], c) for k, c in samples], self.settings),
        )

    def image_bits(self, wanted: IntArray) -> dict[Pair, float]:
        """The evidence of the best alignment with the mirror image of each pair's second map."""
        told = self._all(Kind.IMAGE, wanted, _told, said=True)
        pairs = ((i, j) for i, j in wanted.tolist())
        bits = (-np.inf if t.faint is None else t.faint.bits for t in told)
        return dict(zip(pairs, bits, strict=True))

    def _all(self, kind: Kind, wanted: IntArray, read: Read[T], *, said: bool = False) -> list[T]:
        """What is read of a record for each pair, in their order; read: None if it cannot be of
        them. What is not known is matched."""
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
        """Records for some of the pairs: of each pack its rows, and the places of the pairs."""
        key = self._number[wanted[:, 0]] * len(self._row) + self._number[wanted[:, 1]]
        store = self.means.store
        for pack in self._packs if store is None else store.packs(self.digests):
            keys, rows = self._keys(kind, pack)
            if len(keys):
                at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
                places = np.flatnonzero(keys[at] == key)
                yield pack, rows[at[places]].tolist(), places.tolist()

    def _keys(self, kind: Kind, pack: Pack) -> tuple[IntArray, IntArray]:
        """The records of a pack that are of a kind and of maps of the batch: their pairs as
        numbers, ascending, and their rows."""
        known = self._sorted.get((id(pack), kind))
        if known is None or known[0] is not pack:
            number = {digest: k for k, digest in enumerate(self._row)}
            to = np.array([number.get(d, -1) for d in pack.digests] or [-1], np.int64)
            a, b = to[pack.rows["a"]], to[pack.rows["b"]]
            rows = np.flatnonzero((a >= 0) & (b >= 0) & (pack.rows["kind"] == kind))
            keys = a[rows] * len(self._row) + b[rows]
            order = np.argsort(keys, kind="stable")
            known = pack, keys[order], rows[order]
            self._sorted[id(pack), kind] = known
        return known[1], known[2]

    def _candidates(self, pack: Pack, row: int, pair: IntArray) -> tuple[Candidate, ...] | None:
        """What a record says in full; None if it cannot be of this pair."""
        if not pack.rows["size"][row]:
            return ()
        payload = pack.payload(row)
        if payload is None:
            return None
        return from_bytes(payload, *(self.extents[k] for k in pair.tolist()))

    def _matched(
        self, kind: Kind, wanted: IntArray, missing: IntArray
    ) -> Iterator[tuple[IntArray, Pack]]:
        """Results that are not known: the places of pairs, and a pack with a record for each."""
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
            yield from ((k, _match_all(task, self._ready)) for k, task in enumerate(tasks))
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
        """The missing pairs tile by tile, with their places."""
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


def tile_order(pairs: IntArray) -> IntArray:
    """The order in which (k, 2) pairs are taken, tile by tile."""
    tile = pairs // TASKS.tile
    return np.lexsort((tile[:, 1], tile[:, 0]))


def in_tiles(pairs: IntArray) -> IntArray:
    """The pairs in that order."""
    return pairs[tile_order(pairs)]


def _told(pack: Pack, row: int, _: IntArray) -> Told:
    """What a record says in short."""
    record = pack.rows[row]
    bits, against_chance = float(record["bits"]), float(record["beyond"])
    junctions, size = int(record["junctions"]), int(record["size"])
    faint = Faint(junctions, bits, against_chance) if junctions and not size else None
    return Told(faint, against_chance, size > 0)


def _made(found: T | None) -> T:
    if found is None:
        raise DataError("a worker sent results that cannot be of the maps that it was given")
    return found


def matched(task: MatchTask) -> bytes:
    """Do a task, wherever this is: a pack of a record for each pair, in their order."""
    run_of = {digest: run for run, digest in task.runs}

    def ready(digest: bytes, image: bool) -> Prepared:
        found = _ready.get((digest, image))
        if found is None:
            if len(_ready) >= TASKS.at_hand:
                _ready.clear()
            topomap = task.sent.get(digest) or _read(task.maps, run_of[digest], digest)
            found = prepare(mirrored(topomap) if image else topomap)
            _ready[digest, image] = found
        return found

    return _match_all(task, ready).to_bytes()


_ready: dict[tuple[bytes, bool], Prepared] = {}  # in a worker: maps that the last tasks asked for


def _read(maps: Maps | None, run: str, digest: bytes) -> TopoMap:
    found = None if maps is None else maps.read_map(run)
    if found is None or digest_of(found) != digest:
        raise DataError(f"the map of run {run!r} changed while it was merged; merge again")
    return found


def _match_all(task: MatchTask, ready: Ready) -> Pack:
    """The records of a task."""
    out = PackWriter(era_of(task.settings))
    digests = [digest for _, digest in task.runs]
    pairs = [(digests[i], digests[j]) for i, j in task.pairs.tolist()]
    if task.kind is Kind.ITSELF:
        own = self_matches((ready(digest, False) for digest, _ in pairs), task.settings)
        for pair, found in zip(pairs, own, strict=True):
            out.add(pair, task.kind, payload=to_bytes(found))
        return out.pack()
    image = task.kind is Kind.IMAGE
    both = ((ready(a, False), ready(b, image)) for a, b in pairs)
    for pair, found in zip(pairs, match_all(both, task.settings), strict=True):
        kept = in_short(found, task.settings)
        if image:
            kept = Found(faint=Faint(len(found[0]), found[0].bits) if found else None)
        faint = kept.faint or Faint(0, 0.0)
        out.add(
            pair,
            task.kind,
            junctions=faint.junctions,
            bits=faint.bits,
            beyond=kept.against_chance(task.settings),
            payload=to_bytes(kept.candidates),
        )
    return out.pack()
