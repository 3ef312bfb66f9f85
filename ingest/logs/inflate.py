"""Decompression without trust in declared sizes: bounded and checked."""

from __future__ import annotations

import bz2
import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

try:  # ten times as fast as the standard library's, which takes as long as lz4 itself
    from isal.isal_zlib import crc32
except ImportError:  # a platform without its wheel
    from zlib import crc32

from .columns import words
from .messages import LATEST_NS, OBJECT_BYTES, Block, DamageError

WHOLE_BYTES = 1 << 24
"""Chunks up to this size are decompressed at once, larger ones in pieces. Writers use 1 to 16
MiB."""

PIECE_BYTES = 1 << 22
"""Bytes of a stream, or of messages, that are decompressed at once."""

INPUT_BYTES = 1 << 12
"""Bytes read to be decompressed: of a stream that breaks off, all but so many are used."""

WINDOW_BYTES = 1 << 26
"""Largest zstd window allocated when a stream is read piece by piece (zstd -19 uses 8 MiB, its
longest mode 128 MiB)."""

INFLATED_BYTES = 1 << 28
"""Limit of what the chunks of one file may together decompress to beyond plausible ratios: a second
of zstd."""

RATIOS, COSTS = {"bz2": 100}, {"bz2": 2}
"""Plausible ratios, up to which decompression is unlimited, 1000 for others: empty cost maps reach
500 with zstd, lz4 cannot exceed 255. Factors of the cost of a byte."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_ZSTD_WORD = int.from_bytes(ZSTD_MAGIC, "little")


@functools.cache
def keep_freed_memory() -> None:
    """Make the C library reuse the memory of one chunk for the next.

    glibc maps every block above a threshold anew, and the page faults cost more than lz4 itself.
    Freeing one large, untouched block raises that threshold to its size; other C libraries are not
    affected. Once per process is enough.
    """
    np.empty(8 << 20, np.uint8)


def checksum(data: Any, before: int = 0) -> int:
    """CRC-32 of a buffer, behind data of the checksum `before`."""
    return int(crc32(data, before))


WRONG_SIZE = "a chunk does not decompress to its declared size"


def excess(compression: str, packed: int, size: int) -> int:
    """What decompressing `packed` to `size` bytes costs beyond a plausible ratio."""
    return max(size - RATIOS.get(compression, 1000) * packed, 0) * COSTS.get(compression, 1)


@contextmanager
def _translated(what: str) -> Iterator[None]:
    """Errors of the libraries as DamageErrors."""
    import zstandard

    broken = (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError)
    try:
        yield
    except broken as error:
        raise DamageError(f"{what} does not decompress") from error


def inflate(compression: str, data: bytes, size: int) -> bytes:
    """Exactly `size` bytes out of `data`, or DamageError. Never allocates more than `size`.

    compression: "zstd", "lz4" or "bz2".
    """
    import lz4.frame

    with _translated(f"its {compression} stream"):
        if compression == "zstd":
            out: bytes = _decompressor().stream_reader(data).read(size + 1)
        elif compression == "lz4":
            out = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
        elif compression == "bz2":
            out = bz2.BZ2Decompressor().decompress(data, size + 1)
        else:
            raise _unknown(compression)
    if len(out) != size:
        raise DamageError(WRONG_SIZE)
    return out


def _unknown(compression: str) -> DamageError:
    return DamageError(f"compression {compression[:40]!r} is not known")


_local = threading.local()


def _decompressor() -> Any:
    """That of this thread: threads cannot share one, and making one takes 70 µs."""
    import zstandard

    if not hasattr(_local, "zstd"):
        _local.zstd = zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES)
    return _local.zstd


def pieces(compression: str, source: Any) -> Iterator[bytes]:
    """The decompressed stream of a file in pieces of at most PIECE_BYTES, up to its end or its
    data's.

    Raises DamageError at a broken place, after everything before it: what is left of a stream is
    returned before an error is raised.
    """
    import lz4.frame
    import zstandard

    with _translated(f"its {compression} stream"):
        reader = source
        if compression == "zstd":
            decompressor = zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES)
            reader = decompressor.stream_reader(source, read_size=INPUT_BYTES)
        elif compression == "bz2":
            reader = bz2.BZ2File(reader)
        elif compression == "lz4":
            reader = lz4.frame.LZ4FrameFile(source)
        elif compression:
            raise _unknown(compression)
        while piece := (reader.read1 if compression else reader.read)(PIECE_BYTES):
            yield piece


# Messages that are compressed one by one


def inflate_message(data: bytes, limit: int = OBJECT_BYTES) -> bytes:
    """One zstd payload of unknown size, at most `limit` bytes; else DamageError."""
    import zstandard

    with _translated("a compressed message"):
        if zstandard.frame_content_size(data) > limit:
            raise DamageError(f"a message declares more than {limit >> 20} MiB")
        out: bytes = _decompressor().decompress(data, max_output_size=limit)
    return out


def unpacked(block: Block, encoding: str) -> Iterator[tuple[Block, int]]:
    """A block as blocks of plain payloads with plausible times, each with the number of messages
    left out that do not decompress: ROS 2 can compress single messages, in CDR, by zstd."""
    block = block._replace(log_time_ns=np.clip(block.log_time_ns, 0, LATEST_NS - 1))
    packed = block.size >= 9
    if encoding == "cdr":
        packed[packed] = words(block.data, "<u4", block.start[packed]) == _ZSTD_WORD
    if encoding != "cdr" or not packed.any():
        yield block, 0
        return
    held: list[bytes] = []
    rows: list[int] = []
    failed = held_bytes = 0
    for k, payload in enumerate(block.payloads()):
        try:
            held.append(inflate_message(payload) if packed[k] else payload)
            rows.append(k)
            held_bytes += len(held[-1])
        except DamageError:
            failed += 1
        if held_bytes > PIECE_BYTES or k + 1 == len(packed):
            yield Block.of(block.sink, block.log_time_ns[rows], held), failed
            held, rows, failed, held_bytes = [], [], 0, 0
