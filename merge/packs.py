"""Packs: results of matching pairs of maps as bytes, found again by the content of the maps.

A pack is what one batch of pairs gave; workers send packs, the cache of a workspace keeps them.
Nothing in it is believed: damage shows in its checksums, and what does not is looked through by
whoever reads a payload.

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
"""a, b: rows of the maps' digests; kind: of the result, up to who matches; junctions, bits,
beyond: all there is to say where size is 0; start, size, check: bytes of the payload and their
checksum."""

LARGEST = 1e9
"""No number of a result is larger: metres, bits."""


class Kind(IntEnum):
    """What a record of a pack tells of its key: two maps, by their digests, or twice the digest of
    all that something is made of."""

    PAIR = 0
    ITSELF = 1
    IMAGE = 2
    """The first map against the mirror image of the second."""
    COMPONENT = 3
    """Several maps fused into one."""
    CHANCES = 4
    """What the index gives pairs of many maps."""
    PROBES = 6
    """What the index asks of a map; its key is twice the map's digest."""
    COPIES = 7
    """How copies of places differ, by some maps; its key is twice the digest of theirs."""
    VERDICT = 5
    """What two maps say by themselves; its key is of both maps and of what they must reach."""
    RIVALS = 8
    """Two maps, as far as they are matched, with all other hypotheses beyond chance."""
    MAP = 9
    """A map; its key is twice the digest of its document."""
    TEXT = 10
    """What the document says of a component's places; its key is of the component and of the names
    of its runs."""

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
    """Bytes that are no pack, or none that is whole."""


def checksum(payload: bytes) -> int:
    """CRC-32 of a payload, as RECORD holds it: it tells damage and nothing else, and a quarter of
    the time of a digest is enough for that."""
    return zlib.crc32(payload)


class Payloads(Protocol):
    """Bytes in a row, here or in a file."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> bytes: ...


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class InFile:
    """Bytes of a file from `start` on, read as they are asked for: a large cache is no memory. The
    file is closed with this."""

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
    """Results of pairs of some maps. era: what else they depend on (the program, its settings)."""

    era: bytes
    digests: tuple[bytes, ...]
    rows: Rows
    payloads: Payloads

    def __len__(self) -> int:
        return len(self.rows)

    def payload(self, row: int) -> bytes | None:
        """The payload of a record; None where it is damaged."""
        return self.read(*(int(self.rows[name][row]) for name in ("start", "size", "check")))

    def read(self, start: int, size: int, check: int) -> bytes | None:
        """The same by what its record says."""
        found = self.payloads[start : start + size]
        return found if not size or checksum(found) == check else None

    def to_bytes(self) -> bytes:
        """The pack as it is kept and sent."""
        body = b"".join(self.digests) + self.rows.tobytes()
        sizes = (len(self.digests), len(self.rows), len(self.payloads))
        head = HEAD.pack(MAGIC, self.era, *sizes, digested(body))
        return head + body + self.payloads[:]

    @classmethod
    def from_bytes(cls, data: bytes) -> Pack:
        """Raises DamagedPackError. Payloads are checked one by one, when they are wanted."""
        era, maps, payload, check = _head(data[: HEAD.size], len(data))
        start = len(data) - payload
        return cls._of_body(era, maps, data[HEAD.size : start], check, data[start:])

    @classmethod
    def of_file(cls, file: BinaryIO) -> Pack:
        """The same of a file, from which payloads are read when they are wanted."""
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
    """Era, maps, bytes of payloads and checksum of a pack of so many bytes."""
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
        """One result, by the digests of its maps."""
        a, b = (self._number.setdefault(d, len(self._number)) for d in pair)
        check = checksum(payload) if payload else 0
        self._rows.append((a, b, kind, junctions, bits, beyond, self._end, len(payload), check))
        self._payloads.append(payload)
        self._end += len(payload)

    def pack(self) -> Pack:
        """All that was added."""
        rows = np.array(self._rows, RECORD)
        return Pack(self.era, tuple(self._number), rows, b"".join(self._payloads))


class Store(Protocol):
    """Where the results of an era are kept from merge to merge."""

    @property
    def era(self) -> bytes:
        """What they depend on beside their keys: the program, its settings."""
        ...

    def packs(self, digests: Sequence[bytes]) -> list[Pack]:
        """All that is known and was kept; what is about things of such digests is wanted."""
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
    """Results that are found and left one by one. digest: of a map."""

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
    """Flat arrays of numbers as a payload."""
    flat = [a.reshape(-1).astype("<i8" if a.dtype.kind == "i" else "<f8") for a in arrays]
    sizes = np.array([len(a) for a in flat], "<i8")
    return sizes.tobytes() + b"".join(a.tobytes() for a in flat)


def arrays_from_bytes(data: bytes, kinds: str) -> list[NDArray[Any]] | None:
    """The arrays of a payload; kinds: of each, "i" or "f". None where it cannot hold them, or holds
    what is no number."""
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
