"""Tasks: pairs of maps matched by one worker, as a pure function.

A task names maps by run and content digest; the worker reads them. Results come back as packs,
whoever made them, so that one process, many, and a cache give the same numbers.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Protocol

import numpy as np
import scipy

from ...topology.arrays import IntArray
from ...topology.errors import DataError
from ...topology.topomap import TopoMap
from ..digests import DIGEST, digest_of, digested
from ..packs import Kind, Pack, PackWriter
from .alignment import match_all, self_matches
from .mirror import mirrored
from .prepare import Prepared, prepare
from .records import Found, in_short, to_bytes
from .settings import DEFAULT_ROBUST, RobustSettings
from .verdict import Faint

Ready = Callable[[bytes, bool], Prepared]
"""Gives the prepared map of a digest, or its mirror image."""


class Maps(Protocol):
    """A source of the maps of runs, for workers."""

    def read_map(self, run: str) -> TopoMap:
        """The map of a run."""
        ...


@dataclass(frozen=True, slots=True)
class TaskSettings:
    """How pairs are divided among workers, without influence on the results."""

    tile: int = 32
    """Maps per side of the tiles in which pairs are taken; a task is at most one tile: a map that
    is read serves a row of it, and the overhead of a task is small beside a second of work. Even
    few pairs are divided into as many tasks, for the sake of several workers."""
    at_hand: int = 256
    """Maps that a worker caches, and that the index searches at once: some 100 kB each."""


TASKS = TaskSettings()


@dataclass(frozen=True, slots=True, eq=False)
class MatchTask:
    """Pairs to be matched.

    kind: of the records wanted; runs: name and digest of each map; pairs: (k, 2) rows of them;
    maps: their source; sent: the maps themselves, by digest, if there is no source.
    """

    kind: Kind
    runs: tuple[tuple[str, bytes], ...]
    pairs: IntArray
    settings: RobustSettings
    maps: Maps | None = None
    sent: Mapping[bytes, TopoMap] = field(default_factory=dict)


def tile_order(pairs: IntArray) -> IntArray:
    """The order in which (k, 2) pairs are taken, tile by tile."""
    tile = pairs // TASKS.tile
    return np.lexsort((tile[:, 1], tile[:, 0]))


def in_tiles(pairs: IntArray) -> IntArray:
    """The pairs in that order."""
    return pairs[tile_order(pairs)]


def era_of(settings: RobustSettings) -> bytes:
    """Digest that changes whenever results may: of the program, the libraries and the settings of
    matching."""
    told = asdict(replace(settings, false_merge_rate=DEFAULT_ROBUST.false_merge_rate))
    parts = [_program(), np.__version__, scipy.__version__, told]
    text = json.dumps(parts, sort_keys=True)
    return digested(text.encode())


@cache
def _program() -> str:
    """Digest of all code that matching can reach, because a version number might be forgotten."""
    root = Path(__file__).parents[2]
    out = hashlib.blake2b(digest_size=DIGEST)
    for folder in ("topology", "merge"):
        for path in sorted((root / folder).rglob("*.py")):
            out.update(path.relative_to(root).as_posix().encode())
            out.update(path.read_bytes())
    return out.hexdigest()


def matched(task: MatchTask) -> bytes:
    """Do a task in a worker process: a pack with a record for each pair, in their order."""
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

    return match_task(task, ready).to_bytes()


_ready: dict[tuple[bytes, bool], Prepared] = {}  # in a worker: maps that the last tasks asked for


def _read(maps: Maps | None, run: str, digest: bytes) -> TopoMap:
    found = None if maps is None else maps.read_map(run)
    if found is None or digest_of(found) != digest:
        raise DataError(f"the map of run {run!r} changed while it was merged; merge again")
    return found


def match_task(task: MatchTask, ready: Ready) -> Pack:
    """Do a task: the records of its pairs."""
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
    every = match_all(both, task.settings, rivals=task.kind is Kind.RIVALS)
    for pair, found in zip(pairs, every, strict=True):
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
