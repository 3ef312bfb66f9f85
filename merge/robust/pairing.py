"""The pairwise stage: earlier results are looked up, other pairs matched, here or by workers.

A task is pairs of maps matched by one worker, as a pure function. It names maps by run and content
digest; the worker reads them. All results are bytes: one process, many, and a cache agree.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TypeVar

import numpy as np
import scipy

from ...topology.arrays import IntArray
from ...topology.errors import DataError
from ...topology.topomap import TopoMap
from .. import codec
from ..kept import Kept, Kind, digest_of, digested, program_digest
from ..workers import Workers
from .alignment import Candidate, image_bits, match_all, self_matches
from .conflicts import Conflicts, Unseen
from .prepare import Prepared, prepare
from .settings import DEFAULT_ROBUST, MATCH, RobustSettings
from .support import Support
from .verdict import Faint, beyond_chance_bits, faint_alignment
from .view_evidence import ViewEvidence

Pair = tuple[int, int]
T = TypeVar("T")

Ready = Callable[[bytes], Prepared]
"""Gives the prepared map of a digest."""

ReadMap = Callable[[str], TopoMap]
"""Reads the map of a run; workers are sent it, and call it."""


@dataclass(frozen=True, slots=True)
class TaskSettings:
    """How pairs are divided among workers, without influence on the results."""

    tile: int = 16
    """Maps per side of a tile of pairs. A task is at most one tile: a map that is read serves a row
    of it, and the overhead of a task is small beside a second of work. Even few pairs are divided
    into so many tasks, so that several workers have some."""
    of_views: int = 50
    """Pairs of maps without views that take as long as one with views: about .1 s of CPU time."""
    at_hand: int = 256
    """Maps that a worker caches, and that the index searches at once: about 100 kB each."""


TASKS = TaskSettings()


@dataclass(frozen=True, slots=True, eq=False)
class MatchTask:
    """Pairs to be matched.

    kind: of match; runs: name and digest of each map; pairs: (k, 2) rows of these; read: gives
    uncached maps.
    """

    kind: Kind
    runs: tuple[tuple[str, bytes], ...]
    pairs: IntArray
    settings: RobustSettings
    read: ReadMap | None = None


def tile_order(pairs: IntArray) -> IntArray:
    """Row numbers that order (k, 2) pairs tile by tile."""
    tile = pairs // TASKS.tile
    return np.lexsort((tile[:, 1], tile[:, 0]))


def era_of(settings: RobustSettings) -> bytes:
    """Digest of what results depend on beside maps: program, libraries and settings."""
    values = asdict(replace(settings, false_merge_rate=DEFAULT_ROBUST.false_merge_rate))
    program = program_digest("topology", "merge").hex()
    parts = [program, np.__version__, scipy.__version__, values]
    text = json.dumps(parts, sort_keys=True)
    return digested(text.encode())


HEAD = struct.Struct("<Idd")
"""Head of the result of a match: junctions and bits of the best alignment if none is beyond chance,
else 0; largest evidence against chance. Candidates beyond chance follow, if there are any."""

IMAGE = struct.Struct("<d")
"""The evidence for a mirror image."""

CLASSES = {cls.__name__: cls for cls in (Candidate, Support, Conflicts, Unseen, ViewEvidence)}


@dataclass(frozen=True, slots=True)
class Summary:
    """The head of the result of a match.

    faint: the best alignment if none is beyond chance; against_chance: largest evidence against
    chance of any alignment with enough junctions to be merged [bits]; full: whether candidates are
    beyond chance.
    """

    faint: Faint | None = None
    against_chance: float = 0.0
    full: bool = False

    @classmethod
    def of(cls, data: bytes) -> Summary:
        """The head of the bytes of a result."""
        junctions, bits, against_chance = HEAD.unpack_from(data)
        faint = Faint(junctions, bits) if junctions else None
        return cls(faint, against_chance, len(data) > HEAD.size)


def candidates_of(data: bytes) -> tuple[Candidate, ...]:
    """The candidates in the bytes of a result."""
    return codec.from_bytes(data[HEAD.size :], CLASSES) if len(data) > HEAD.size else ()


def image_bits_of(data: bytes) -> float:
    """The number in the bytes of the result of a match with a mirror image."""
    (bits,) = IMAGE.unpack(data)
    return float(bits)


def results_of(
    kind: Kind, maps: Iterable[tuple[Prepared, Prepared]], settings: RobustSettings
) -> list[bytes]:
    """The bytes kept of each pair of maps."""
    if kind is Kind.MIRRORED:
        return [IMAGE.pack(bits) for bits in image_bits(maps, settings)]
    if kind is Kind.ITSELF:
        candidates = self_matches((m for m, _ in maps), settings)
    else:
        candidates = match_all(maps, settings)
    return [_candidate_bytes(found, settings) for found in candidates]


def _candidate_bytes(found: tuple[Candidate, ...], settings: RobustSettings) -> bytes:
    """The bytes kept of candidates: those beyond chance, or a summary of the best."""
    beyond = tuple(c for c in found if c.bits > MATCH.lead_bits)
    against_chance = beyond_chance_bits(beyond or found, settings)
    if beyond:
        return HEAD.pack(0, 0.0, against_chance) + codec.to_bytes(beyond)
    faint = faint_alignment(found) or Faint(0, 0.0)
    return HEAD.pack(faint.junctions, faint.bits, against_chance)


def do_task(task: MatchTask) -> tuple[bytes, list[bytes]]:
    """Do a task in a worker process. Returns the worker's era, and the result of each pair."""
    run_of = {digest: run for run, digest in task.runs}

    def ready(digest: bytes) -> Prepared:
        if digest not in _ready:
            if len(_ready) >= TASKS.at_hand:
                _ready.clear()
            _ready[digest] = prepare(_unchanged_map(task.read, run_of[digest], digest))
        return _ready[digest]

    return era_of(task.settings), match_task(task, ready)


_ready: dict[bytes, Prepared] = {}  # in a worker: the maps of its last tasks


def _unchanged_map(read: ReadMap | None, run: str, digest: bytes) -> TopoMap:
    """The map of a run; DataError if it is not that of the digest."""
    topomap = None if read is None else read(run)
    if topomap is None or digest_of(topomap) != digest:
        raise DataError(f"the map of run {run!r} changed while it was merged; merge again")
    return topomap


def match_task(task: MatchTask, ready: Ready) -> list[bytes]:
    """Do a task. Returns the result of each pair."""
    digests = [digest for _, digest in task.runs]
    maps = ((ready(digests[i]), ready(digests[j])) for i, j in task.pairs.tolist())
    return results_of(task.kind, maps, task.settings)


@dataclass(frozen=True, slots=True)
class Means:
    """How the pairs of a batch are matched, without influence on the results.

    workers: executors that read the maps by `read`; this process where one of the two is None;
    kept: known results, of the era of the settings; on_pair(done, total): called for progress,
    first with the number of known results; on_event: called with one line of text per event.
    """

    workers: Workers | None = None
    read: ReadMap | None = None
    kept: Kept = field(default_factory=Kept)
    on_pair: Callable[[int, int], None] | None = None
    on_event: Callable[[str], None] | None = None

    def log(self, text: str) -> None:
        """Report an event, if `on_event` is given."""
        if self.on_event is not None:
            self.on_event(text)


class Pairwise:
    """The maps of a batch, sorted by run, for matching with each other."""

    def __init__(
        self, maps: Sequence[TopoMap], settings: RobustSettings, means: Means | None = None
    ) -> None:
        self.maps = maps
        self.settings = settings
        self.means = means or Means()
        self.prepared = [prepare(m) for m in maps]
        self.digests = [self.means.kept.digest(m) for m in maps]
        self._row = {digest: k for k, digest in enumerate(self.digests)}

    def pairs(self, pairs: IntArray) -> list[Summary]:
        """The summary of the match of each of (k, 2) pairs."""
        return self._all(Kind.PAIR, pairs, Summary.of, reported=True)

    def candidates(self, pairs: IntArray) -> list[tuple[Candidate, ...]]:
        """The candidates beyond chance of each of (k, 2) pairs."""
        return self._all(Kind.PAIR, pairs, candidates_of)

    def image_bits(self, pairs: IntArray) -> list[float]:
        """The evidence for the mirror image of each of (k, 2) pairs."""
        return self._all(Kind.MIRRORED, pairs, image_bits_of, reported=True)

    def with_themselves(self) -> list[tuple[Candidate, ...]]:
        """Matches of every map with other parts of itself."""
        rows = np.arange(len(self.maps)).repeat(2).reshape(-1, 2)
        return self._all(Kind.ITSELF, rows, candidates_of, reported=True)

    def _all(
        self, kind: Kind, pairs: IntArray, read: Callable[[bytes], T], *, reported: bool = False
    ) -> list[T]:
        """The result of each pair, in order, as `read` decodes it. Unknown pairs are matched.
        reported: whether progress and the number of known results are reported."""
        kept, done = self.means.kept, 0
        keys = [(self.digests[i], self.digests[j]) for i, j in pairs.tolist()]

        def report(count: int) -> None:
            nonlocal done
            done += count
            if kind is Kind.PAIR and reported and self.means.on_pair is not None:
                self.means.on_pair(done, len(pairs))

        known_results = (None if data is None else read(data) for data in kept.find(kind, keys))
        results = dict(enumerate(known_results))
        missing = np.array([k for k, found in results.items() if found is None], np.int64)
        report(len(pairs) - len(missing))
        if reported and len(pairs):
            already = f"{len(pairs) - len(missing)} are known already"
            self.means.log(f"{kind}: {len(pairs)}, of which {already}")
        for rows, new_results in self._match_missing(kind, pairs, missing):
            for row, data in zip(rows, new_results, strict=True):
                kept.add(kind, keys[row], data)
                results[row] = read(data)
            report(len(rows))
        return [found for found in results.values() if found is not None]

    def _match_missing(
        self, kind: Kind, pairs: IntArray, missing: IntArray
    ) -> Iterator[tuple[list[int], list[bytes]]]:
        """New results: positions of pairs, and the result of each."""
        tasks = list(self._tasks(kind, pairs, missing))
        workers = None if self.means.read is None else self.means.workers
        if workers is None or len(tasks) < 2 or self._work(pairs[missing]) < workers.worth:
            yield from ((at, match_task(task, self._ready)) for at, task in tasks)
            return
        era = era_of(self.settings)
        for k, (of_worker, results) in workers.results(do_task, [task for _, task in tasks]):
            if of_worker != era:
                raise DataError(
                    "a worker runs another version of topobatch, numpy or scipy than this "
                    "process: install the same on all machines"
                )
            yield tasks[k][0], results

    def _work(self, pairs: IntArray) -> int:
        """The time that (k, 2) pairs take to match, in pairs of maps without views."""
        has_views = np.array([len(m.views) > 0 for m in self.maps])
        return len(pairs) + TASKS.of_views * int(has_views[pairs].all(axis=1).sum())

    def _ready(self, digest: bytes) -> Prepared:
        # Maps of different names may have one digest: any of them will do.
        return self.prepared[self._row[digest]]

    def _tasks(
        self, kind: Kind, pairs: IntArray, missing: IntArray
    ) -> Iterator[tuple[list[int], MatchTask]]:
        """The missing pairs tile by tile, with their positions."""
        order = missing[tile_order(pairs[missing])]
        size = min(TASKS.tile**2, max(-(-len(order) // TASKS.tile), 1))
        for start in range(0, len(order), size):
            batch = order[start : start + size]
            maps, rows = np.unique(pairs[batch], return_inverse=True)
            task = MatchTask(
                kind=kind,
                runs=tuple((self.maps[k].run, self.digests[k]) for k in maps.tolist()),
                pairs=rows.reshape(-1, 2),
                settings=self.settings,
                read=self.means.read,
            )
            yield batch.tolist(), task
