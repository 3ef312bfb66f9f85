"""Decompression without trust in declared sizes: bounded, checked, and able to recover a part."""

from __future__ import annotations

import bz2
import functools
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

try:  # ten times as fast as the standard library's, which takes as long as lz4 itself
    from isal.isal_zlib import crc32
except ImportError:  # a platform without its wheel
    from zlib import crc32

from .columns import words
from .messages import MESSAGE_BYTES, Block, DamageError

WHOLE_BYTES = 1 << 24
"""Chunks up to this size are decompressed at once, larger ones in pieces. Writers use 1 to 16
MiB."""

PIECE_BYTES = 1 << 20
INPUT_BYTES = 1 << 16
"""Bytes decompressed, and read to be decompressed, at once."""

WINDOW_BYTES = 1 << 26
"""Largest zstd window allocated when a stream is read piece by piece (zstd -19 uses 8 MiB, its
longest mode 128 MiB)."""

INFLATED_BYTES = 1 << 28
"""Limit of what the chunks of one file may together decompress to beyond plausible ratios: a second
of zstd."""

DEARER = {"bz2": 2}
"""Factor of the cost of a byte."""

RATIOS = {"zstd": 1000, "bz2": 100}
"""Plausible ratios, up to which decompression is unlimited: empty cost maps reach 500. lz4 cannot
exceed 255."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

SLOW = frozenset({"zstd", "bz2"})
"""Compressions worth another thread: lz4 decompresses faster than a chunk moves between cores."""

_local = threading.local()


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


class WrongSizeError(DamageError):
    """Data decompress to another size than declared."""

    def __init__(self) -> None:
        super().__init__("a chunk does not decompress to its declared size")


class LimitError(DamageError):
    """A chunk decompresses to more than is allowed."""

    def __init__(self) -> None:
        super().__init__("they inflate to far more than logs do")


class Allowance:
    """What the chunks of one file may still decompress to beyond plausible ratios."""

    def __init__(self) -> None:
        self._left = INFLATED_BYTES

    def take(self, compression: str, packed: int, size: int) -> None:
        """Count a chunk that decompresses from `packed` to `size` bytes; raises LimitError."""
        excess = max(size - RATIOS.get(compression, 1000) * packed, 0) * DEARER.get(compression, 1)
        if excess > self._left:
            raise LimitError
        self._left -= excess

    def limit(self, compression: str, packed: int) -> int:
        """The largest size that `packed` bytes may decompress to."""
        return RATIOS.get(compression, 1000) * packed + self._left // DEARER.get(compression, 1)


def inflate(compression: str, data: Any, size: int) -> bytes:
    """Exactly `size` bytes out of `data`, or DamageError. Never allocates more than `size`.

    compression: "zstd", "lz4" or "bz2"; data: a buffer; size: at most WHOLE_BYTES.
    """
    if size > WHOLE_BYTES:
        raise WrongSizeError
    out = _inflater(compression)(data, size)
    if len(out) != size:
        raise WrongSizeError
    return out


def inflate_part(compression: str, data: Any, limit: int = WHOLE_BYTES) -> bytes:
    """As much as can be recovered of a truncated or damaged stream, at most `limit`; never
    fails."""
    out, done = [], 0
    try:
        # Small bites: what was decoded before the broken place is kept.
        for piece in pieces(compression, _reader_of(data), 4096):
            out.append(piece[: limit - done])
            done += len(out[-1])
            if done >= limit:
                break
    except DamageError:
        pass
    return b"".join(out)


Read = Callable[[int], bytes]
"""Reads the next bytes of a source, at most so many; none at its end."""


def _reader_of(data: Any) -> Read:
    view, at = memoryview(data), 0

    def read(size: int) -> bytes:
        nonlocal at
        at += size
        return bytes(view[at - size : at])

    return read


def pieces(compression: str, read: Read, bite: int = INPUT_BYTES) -> Iterator[bytes]:
    """A decompressed stream in pieces of at most PIECE_BYTES, up to its end or its data's.

    Raises DamageError at a broken place, after everything before it.
    """
    if compression == "":
        while piece := read(PIECE_BYTES):
            yield piece
        return
    _inflater(compression)
    make = {"zstd": _zstd_pieces, "lz4": _lz4_pieces, "bz2": _bz2_pieces}[compression]
    try:
        yield from make(read, bite)
    except _errors() as error:
        raise DamageError(_BROKEN[compression]) from error


def _zstd_pieces(read: Read, bite: int) -> Iterator[bytes]:
    import zstandard

    class Source:
        """What the library reads from."""

        def read(self, size: int) -> bytes:
            return read(min(size, bite))

    # The buffer is filled as far as it goes before an error is raised.
    source: Any = Source()
    with zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES).stream_reader(
        source, read_size=bite
    ) as reader:
        while piece := reader.read1(PIECE_BYTES):
            yield piece


def _lz4_pieces(read: Read, bite: int) -> Iterator[bytes]:
    import lz4.frame

    yield from _fed(lz4.frame.LZ4FrameDecompressor(), read, bite)


def _bz2_pieces(read: Read, bite: int) -> Iterator[bytes]:
    yield from _fed(bz2.BZ2Decompressor(), read, bite)


def _fed(decompressor: Any, read: Read, bite: int) -> Iterator[bytes]:
    """The output of a decompressor that takes its input in parts."""
    while not decompressor.eof:
        data = read(bite) if decompressor.needs_input else b""
        if decompressor.needs_input and not data:
            return
        if piece := decompressor.decompress(data, PIECE_BYTES):
            yield piece


def inflate_message(data: Any, limit: int = MESSAGE_BYTES) -> bytes:
    """One zstd payload of unknown size, at most `limit` bytes; else DamageError."""
    import zstandard

    try:
        size = zstandard.frame_content_size(data)
        if size > limit:
            raise DamageError(f"a message declares more than {limit >> 20} MiB")
        if size >= 0:
            return inflate("zstd", data, size)
        reader = zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES).stream_reader(data)
        out: bytes = reader.read(limit + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamageError("a compressed message does not decode") from error
    if len(out) > limit:
        raise DamageError(f"a message inflates to more than {limit >> 20} MiB")
    return out


SLICE_BYTES = 1 << 22
"""Bytes of messages decompressed at once."""

_MAGIC = int.from_bytes(ZSTD_MAGIC, "little")


def unpacked(block: Block) -> Iterator[tuple[Block, int]]:
    """A block in CDR whose payloads may be zstd streams (ROS 2 can compress single messages), as
    blocks that are none, each with the number of messages left out that do not decompress."""
    packed = block.size >= 9
    packed[packed] = words(block.data, "<u4", block.start[packed]) == _MAGIC
    if not packed.any():
        yield block, 0
        return
    count = len(packed)
    held: list[bytes] = []
    times: list[int] = []
    failed = held_bytes = 0
    for k, (at, size) in enumerate(zip(block.start.tolist(), block.size.tolist(), strict=True)):
        payload = block.data[at : at + size].tobytes()
        try:
            held.append(inflate_message(payload) if packed[k] else payload)
            times.append(int(block.log_time_ns[k]))
            held_bytes += len(held[-1])
        except DamageError:
            failed += 1
        if held_bytes > SLICE_BYTES or k + 1 == count:
            sizes = np.fromiter(map(len, held), np.int64, len(held))
            data = np.frombuffer(b"".join(held), np.uint8)
            log_ns = np.array(times, np.int64)
            yield Block(data, block.sink, log_ns, np.cumsum(sizes) - sizes, sizes), failed
            held, times, failed, held_bytes = [], [], 0, 0


def _errors() -> tuple[type[BaseException], ...]:
    import zstandard

    return (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError)


def _inflater(compression: str) -> Callable[[Any, int], bytes]:
    try:
        return _INFLATERS[compression]
    except KeyError:
        raise DamageError(f"compression {compression[:40]!r} is not known") from None


_BROKEN = {
    "zstd": "a zstd chunk does not decompress",
    "lz4": "an lz4 chunk does not decompress",
    "bz2": "a bz2 chunk does not decompress",
}


def _zstd(data: Any, size: int) -> bytes:
    import zstandard

    context = getattr(_local, "zstd", None)
    if context is None:
        context = _local.zstd = zstandard.ZstdDecompressor()
    try:
        if zstandard.frame_content_size(data) not in (-1, size):
            raise WrongSizeError
        # No size would mean any size to the library.
        out: bytes = context.decompress(data, max_output_size=max(size, 1))
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamageError(_BROKEN["zstd"]) from error
    return out


def _lz4(data: Any, size: int) -> bytes:
    import lz4.frame

    try:
        declared = lz4.frame.get_frame_info(data)["content_size"]
        if declared not in (0, size):
            raise WrongSizeError
        if declared:
            out: bytes = lz4.frame.decompress(data)
        else:
            out = lz4.frame.LZ4FrameDecompressor().decompress(bytes(data), size + 1)
    except (RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamageError(_BROKEN["lz4"]) from error
    return out


def _bz2(data: Any, size: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, size + 1)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise DamageError(_BROKEN["bz2"]) from error


_INFLATERS: dict[str, Callable[[Any, int], bytes]] = {"zstd": _zstd, "lz4": _lz4, "bz2": _bz2}
