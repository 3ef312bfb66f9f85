"""The pairwise stage: results of earlier merges are looked up, other pairs are matched, here or by
workers (`tasks`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import DataError
from ...topology.topomap import TopoMap
from ..kept import Kept, Kind
from ..workers import Workers
from .alignment import Candidate
from .mirror import mirrored
from .prepare import Prepared, prepare
from .settings import RobustSettings
from .tasks import (
    TASKS,
    MatchTask,
    ReadMap,
    Summary,
    candidates_of,
    era_of,
    image_bits_of,
    match_task,
    matched,
    tile_order,
)

Pair = tuple[int, int]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Means:
    """How the pairs of a batch are matched, without influence on the results.

    workers: executors that read the maps by `read`; this process where one of the two is None;
    kept: known results, of the era of the settings; on_pair(done, total): progress, first with what
    is known already; tell: called with one line of text per event.
    """

    workers: Workers | None = None
    read: ReadMap | None = None
    kept: Kept = field(default_factory=Kept)
    on_pair: Callable[[int, int], None] | None = None
    tell: Callable[[str], None] | None = None

    def say(self, text: str) -> None:
        """Report an event, if `tell` is given."""
        if self.tell is not None:
            self.tell(text)


class Pairwise:
    """The maps of a batch, sorted by run, for matching with each other."""

    def __init__(
        self, maps: Sequence[TopoMap], settings: RobustSettings, means: Means | None = None
    ) -> None:
        self.maps = maps
        self.settings = settings
        self.means = means or Means()
        self.prepared = [prepare(m) for m in maps]
        self.places = [m.xy[:, 0] + 1j * m.xy[:, 1] for m in maps]
        self.digests = [self.means.kept.digest(m) for m in maps]
        self._row = {digest: k for k, digest in enumerate(self.digests)}
        self._images: dict[int, Prepared] = {}

    def pairs(self, wanted: IntArray) -> list[Summary]:
        """The result of matching each of (k, 2) pairs, in short."""
        return self._all(Kind.PAIR, wanted, Summary.of, reported=True)

    def candidates(self, wanted: IntArray) -> list[tuple[Candidate, ...]]:
        """The candidates of each of (k, 2) pairs; none where none is beyond chance."""
        return self._all(Kind.PAIR, wanted, candidates_of)

    def beside_rivals(self, wanted: IntArray) -> list[tuple[Candidate, ...]]:
        """The same including all other hypotheses beyond chance."""
        return self._all(Kind.RIVALS, wanted, candidates_of, reported=True)

    def with_themselves(self) -> list[tuple[Candidate, ...]]:
        """Matches of every map with other parts of itself."""
        rows = np.arange(len(self.maps)).repeat(2).reshape(-1, 2)
        return self._all(Kind.ITSELF, rows, candidates_of, reported=True)

    def image_bits(self, wanted: IntArray) -> dict[Pair, float]:
        """Evidence of the best alignment with the mirror image of each pair's second map [bits]."""
        bits = self._all(Kind.IMAGE, wanted, image_bits_of, reported=True)
        self._images.clear()  # .1 MB a map, and hardly asked for again
        return dict(zip(map(tuple, wanted.tolist()), bits, strict=True))

    def _all(
        self, kind: Kind, wanted: IntArray, read: Callable[[bytes], T], *, reported: bool = False
    ) -> list[T]:
        """The result of each pair, in their order, as `read` gives it. Unknown pairs are
        matched."""
        kept, done = self.means.kept, 0
        keys = [(self.digests[i], self.digests[j]) for i, j in wanted.tolist()]

        def report(more: int) -> None:
            nonlocal done
            done += more
            if kind is Kind.PAIR and reported and self.means.on_pair is not None:
                self.means.on_pair(done, len(wanted))

        known = (None if data is None else read(data) for data in kept.find(kind, keys))
        out = dict(enumerate(known))
        missing = np.array([k for k, found in out.items() if found is None], np.int64)
        report(len(wanted) - len(missing))
        if reported and len(wanted):
            known_already = f"{len(wanted) - len(missing)} are known already"
            self.means.say(f"{kind}: {len(wanted)}, of which {known_already}")
        for places, results in self._matched(kind, wanted, missing):
            for place, data in zip(places, results, strict=True):
                kept.add(kind, keys[place], data)
                out[place] = read(data)
            report(len(places))
        return [found for found in out.values() if found is not None]

    def _matched(
        self, kind: Kind, wanted: IntArray, missing: IntArray
    ) -> Iterator[tuple[list[int], list[bytes]]]:
        """New results: positions of pairs, and the result of each."""
        tasks = list(self._tasks(kind, wanted, missing))
        workers = None if self.means.read is None else self.means.workers
        if workers is None or len(tasks) < 2 or self._work(wanted[missing]) < workers.worth:
            yield from ((at, match_task(task, self._ready)) for at, task in tasks)
            return
        era = era_of(self.settings)
        for k, (of_worker, results) in workers.results(matched, [task for _, task in tasks]):
            if of_worker != era:
                raise DataError(
                    "a worker runs another version of topobatch, numpy or scipy than this "
                    "process: install the same on all machines"
                )
            yield tasks[k][0], results

    def _work(self, wanted: IntArray) -> int:
        """How long (k, 2) pairs take to match, in pairs of maps without views."""
        has_views = np.array([len(m.views) > 0 for m in self.maps])
        return len(wanted) + TASKS.of_views * int(has_views[wanted].all(axis=1).sum())

    def _ready(self, digest: bytes, image: bool) -> Prepared:
        k = self._row[digest]  # of several maps that are the same but for their names any will do
        if not image:
            return self.prepared[k]
        if k not in self._images:
            self._images[k] = prepare(mirrored(self.maps[k]))
        return self._images[k]

    def _tasks(
        self, kind: Kind, wanted: IntArray, missing: IntArray
    ) -> Iterator[tuple[list[int], MatchTask]]:
        """The missing pairs tile by tile, with their positions."""
        order = missing[tile_order(wanted[missing])]
        size = min(TASKS.tile**2, max(-(-len(order) // TASKS.tile), 1))
        for start in range(0, len(order), size):
            places = order[start : start + size]
            maps, rows = np.unique(wanted[places], return_inverse=True)
            task = MatchTask(
                kind=kind,
                runs=tuple((self.maps[k].run, self.digests[k]) for k in maps.tolist()),
                pairs=rows.reshape(-1, 2),
                settings=self.settings,
                read=self.means.read,
            )
            yield places.tolist(), task
