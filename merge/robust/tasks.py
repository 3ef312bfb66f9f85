"""Tasks: pairs of maps matched by one worker, as a pure function.

A task names maps by run and content digest; the worker reads them. Results come back as packs
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
"""The prepared map of a digest, or its mirror image."""


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


def tile_order(pairs: IntArray) -> IntArray:
    """The order in which (k, 2) pairs are taken, tile by tile."""
    tile = pairs // TASKS.tile
    return np.lexsort((tile[:, 1], tile[:, 0]))


def in_tiles(pairs: IntArray) -> IntArray:
    """The pairs in that order."""
    return pairs[tile_order(pairs)]


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

    return match_task(task, ready).to_bytes()


_ready: dict[tuple[bytes, bool], Prepared] = {}  # in a worker: maps that the last tasks asked for


def _read(maps: Maps | None, run: str, digest: bytes) -> TopoMap:
    found = None if maps is None else maps.read_map(run)
    if found is None or digest_of(found) != digest:
        raise DataError(f"the map of run {run!r} changed while it was merged; merge again")
    return found


def match_task(task: MatchTask, ready: Ready) -> Pack:
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
