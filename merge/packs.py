"""Packs: serialised results of matching pairs of maps, keyed by the content of the maps.

A pack holds the results of one batch of pairs; workers send packs, the cache of a workspace keeps
them. Nothing in it is trusted: checksums detect damage, and payloads are validated by their
readers.

    "TOPOPACK"  era  maps  records  payload bytes  checksum of the next two
    (maps, 16)  digests of maps
    (records,)  RECORD: which two maps, what kind of result, a short one in place or its payload
    payloads
"""

from __future__ import annotations

import os
import struct
import weakref
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from ..topology.arrays import FloatArray, IntArray
from ..topology.topomap import TopoMap
from .digests import DIGEST, digest_of, digested

MAGIC = b"TOPOPACK"
HEAD = struct.Struct(f"<8s{DIGEST}sIIQ{DIGEST}s")

RECORD = np.dtype(
    [
        ("a", "<u4"),
        ("b", "<u4"),
        ("kind", "<u4"),
        ("junctions", "<u4"),
        ("bits", "<f8"),
        ("beyond", "<f8"),
        ("start", "<u8"),
        ("size", "<u8"),
        ("check", "<u8"),
    ]
)
"""a, b: rows of the maps' digests; kind: of the result; junctions, bits, beyond: the whole result
if size is 0; start, size, check: offset, bytes and checksum of the payload."""

LARGEST = 1e9
"""Upper bound of all numbers of a result: metres, bits."""


class Kind(IntEnum):
    """The kind of a result, and what its key stands for: two maps, by their digests, or twice the
    digest of something else."""

    PAIR = 0
    ITSELF = 1
    IMAGE = 2
    """The first map matched with the mirror image of the second."""
    COMPONENT = 3
    """Several maps fused into one."""
    CHANCES = 4
    """Screening of pairs of many maps."""
    PROBES = 6
    """Columns of a map for the index; keyed by twice the map's digest."""
    COPIES = 7
    """A copy model; keyed by twice the digest of the maps that it was estimated from."""
    VERDICT = 5
    """The verdict on two maps alone; keyed by both maps and their threshold."""
    RIVALS = 8
    """Two maps matched with all hypotheses beyond chance."""
    MAP = 9
    """A map; keyed by twice the digest of its document."""
    TEXT = 10
    """The document's text of a component's places; keyed by the component and the names of its
    runs."""

    @property
    def told(self) -> str:
        """What is matched, in words."""
        return _TOLD[self]


_TOLD = {
    Kind.PAIR: "pairs of maps",
    Kind.ITSELF: "maps with themselves",
    Kind.IMAGE: "mirror images",
    Kind.RIVALS: "rival placements",
}

Rows = NDArray[np.void]
Key = tuple[bytes, bytes]


class DamagedPackError(ValueError):
    """Bytes that are not a pack, or a damaged one."""


def checksum(payload: bytes) -> int:
    """CRC-32 of a payload: sufficient against damage, at a quarter of the time of a digest."""
    return zlib.crc32(payload)


class Payloads(Protocol):
    """A sequence of bytes, in memory or in a file."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> bytes: ...


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class InFile:
    """Bytes of a file from `start` on, read on access to save memory. The file is closed with
    this."""

    file: BinaryIO
    start: int
    size: int

    def __post_init__(self) -> None:
        weakref.finalize(self, self.file.close)

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, part: slice, /) -> bytes:
        first, stop, _ = part.indices(self.size)
        if stop <= first:
            return b""
        try:
            self.file.seek(self.start + first)
            return self.file.read(stop - first)
        except OSError:
            return b""  # as if it were damaged


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Pack:
    """Results of pairs of some maps. era: digest of what else they depend on (program,
    settings)."""

    era: bytes
    digests: tuple[bytes, ...]
    rows: Rows
    payloads: Payloads

    def __len__(self) -> int:
        return len(self.rows)

    def payload(self, row: int) -> bytes | None:
        """The payload of a record; None if it is damaged."""
        return self.read(*(int(self.rows[name][row]) for name in ("start", "size", "check")))

    def read(self, start: int, size: int, check: int) -> bytes | None:
        """The payload at an offset; None if it is damaged."""
        found = self.payloads[start : start + size]
        return found if not size or checksum(found) == check else None

    def to_bytes(self) -> bytes:
        """The serialised pack."""
        body = b"".join(self.digests) + self.rows.tobytes()
        sizes = (len(self.digests), len(self.rows), len(self.payloads))
        head = HEAD.pack(MAGIC, self.era, *sizes, digested(body))
        return head + body + self.payloads[:]

    @classmethod
    def from_bytes(cls, data: bytes) -> Pack:
        """Inverse of `to_bytes`. Raises DamagedPackError. Payloads are checked on access."""
        era, maps, payload, check = _head(data[: HEAD.size], len(data))
        start = len(data) - payload
        return cls._of_body(era, maps, data[HEAD.size : start], check, data[start:])

    @classmethod
    def of_file(cls, file: BinaryIO) -> Pack:
        """The pack in a file, from which payloads are read on access."""
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        era, maps, payload, check = _head(file.read(HEAD.size), size)
        start = size - payload
        body = file.read(start - HEAD.size)
        return cls._of_body(era, maps, body, check, InFile(file, start, payload))

    @classmethod
    def _of_body(cls, era: bytes, maps: int, body: bytes, check: bytes, payloads: Payloads) -> Pack:
        if digested(body) != check:
            raise DamagedPackError("its checksum is another one")
        table, payload = body[: maps * DIGEST], len(payloads)
        digests = tuple(table[k : k + DIGEST] for k in range(0, len(table), DIGEST))
        rows = np.frombuffer(body, RECORD, offset=len(table))
        beyond = (
            rows["start"] > payload,
            rows["size"] > payload - np.minimum(rows["start"], payload),
        )
        strange = (rows["a"] >= maps) | (rows["b"] >= maps) | beyond[0] | beyond[1]
        numbers = np.stack([rows["bits"], rows["beyond"]])
        if strange.any() or not (np.abs(numbers) <= LARGEST).all():
            raise DamagedPackError("its records point outside of it")
        return cls(era, digests, rows, payloads)


def _head(head: bytes, size: int) -> tuple[bytes, int, int, bytes]:
    """Era, number of maps, bytes of payloads and checksum, from the head of a pack of `size`
    bytes."""
    if len(head) < HEAD.size:
        raise DamagedPackError("too short")
    magic, era, maps, records, payload, check = HEAD.unpack(head)
    if magic != MAGIC or size != HEAD.size + maps * DIGEST + records * RECORD.itemsize + payload:
        raise DamagedPackError("no pack, or cut off")
    return era, maps, payload, check


class PackWriter:
    """Collects results into a pack."""

    def __init__(self, era: bytes) -> None:
        self.era = era
        self._number: dict[bytes, int] = {}
        self._rows: list[tuple[int, int, int, int, float, float, int, int, int]] = []
        self._payloads: list[bytes] = []
        self._end = 0

    def __len__(self) -> int:
        return len(self._rows)

    def add(
        self,
        pair: Key,
        kind: int,
        *,
        junctions: int = 0,
        bits: float = 0.0,
        beyond: float = 0.0,
        payload: bytes = b"",
    ) -> None:
        """Add one result, by the digests of its maps."""
        a, b = (self._number.setdefault(d, len(self._number)) for d in pair)
        check = checksum(payload) if payload else 0
        self._rows.append((a, b, kind, junctions, bits, beyond, self._end, len(payload), check))
        self._payloads.append(payload)
        self._end += len(payload)

    def pack(self) -> Pack:
        """The pack of all that was added."""
        rows = np.array(self._rows, RECORD)
        return Pack(self.era, tuple(self._number), rows, b"".join(self._payloads))


class Store(Protocol):
    """Keeps the results of an era from merge to merge."""

    @property
    def era(self) -> bytes:
        """Digest of what results depend on beside their keys: program, settings."""
        ...

    def packs(self, digests: Sequence[bytes]) -> list[Pack]:
        """All results known; those about the given digests are marked as wanted."""
        ...

    def find(self, kind: Kind, key: Key) -> bytes | None:
        """The payload of one record, if it is known."""
        ...

    def every(self, kind: Kind) -> Iterator[bytes]:
        """The payloads of all records of a kind."""
        ...

    def keep(self, pack: Pack) -> None:
        """Add results."""
        ...


@dataclass(frozen=True, slots=True)
class Kept:
    """Access to single records of a store. digest: of a map."""

    store: Store
    digest: Callable[[TopoMap], bytes] = digest_of

    def find(self, kind: Kind, key: Key) -> bytes | None:
        """The payload of a record, if it is known."""
        return self.store.find(kind, key)

    def every(self, kind: Kind) -> Iterator[bytes]:
        """The payloads of all records of a kind."""
        return self.store.every(kind)

    def add(self, kind: Kind, key: Key, payload: bytes) -> None:
        """Keep a result."""
        out = PackWriter(self.store.era)
        out.add(key, kind, payload=payload)
        self.store.keep(out.pack())


def arrays_to_bytes(arrays: Sequence[IntArray | FloatArray]) -> bytes:
    """Arrays of numbers, flattened, as a payload."""
    flat = [a.reshape(-1).astype("<i8" if a.dtype.kind == "i" else "<f8") for a in arrays]
    sizes = np.array([len(a) for a in flat], "<i8")
    return sizes.tobytes() + b"".join(a.tobytes() for a in flat)


def arrays_from_bytes(data: bytes, kinds: str) -> list[NDArray[Any]] | None:
    """Inverse of `arrays_to_bytes`; kinds: "i" or "f" of each. None if the sizes do not fit or a
    float is not finite or too large."""
    head = 8 * len(kinds)
    if len(data) < head:
        return None
    sizes = np.frombuffer(data, "<i8", len(kinds))
    if (sizes < 0).any() or (sizes > len(data)).any() or head + 8 * sizes.sum() != len(data):
        return None
    out = []
    for kind, size in zip(kinds, sizes.tolist(), strict=True):
        values = np.frombuffer(data, f"<{kind}8", size, head)
        if kind == "f" and not (np.abs(values) <= LARGEST).all():
            return None
        out.append(values.astype(np.int64 if kind == "i" else np.float64))
        head += 8 * size
    return out
