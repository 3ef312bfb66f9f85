"""Decompression that believes no declared size: bounded, checked, and able to save a part."""

from __future__ import annotations

import bz2
import functools
import threading
from typing import Any

import numpy as np

from .messages import DamageError

CHUNK_BYTES = 1 << 29
"""Largest chunk that is inflated. Real writers use 1 to 16 MiB; one image may be 100 MB."""

WINDOW_BYTES = 1 << 27
"""Largest zstd window that is allocated when a stream is read piece by piece."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

SLOW = frozenset({"zstd", "bz2"})
"""Compressions worth another thread: lz4 inflates faster than a chunk goes from core to core."""

_local = threading.local()


@functools.cache
def keep_freed_memory() -> None:
    """Let the C library keep the memory of one chunk for the next.

    glibc maps every block above a threshold anew, and the page faults cost more than lz4 itself.
    Freeing one large block, here an untouched one, raises that threshold to its size; with another
    C library this does nothing. Once per process is enough.
    """
    np.empty(8 << 20, np.uint8)


def inflate(compression: str, data: Any, size: int) -> bytes:
    """Exactly `size` bytes out of `data`, or DamageError. Nothing above `size` is ever allocated.

    compression: "zstd", "lz4" or "bz2"; data: a buffer.
    """
    if size > CHUNK_BYTES:
        raise DamageError(f"a chunk declares more than {CHUNK_BYTES >> 20} MiB")
    try:
        inflater = _INFLATERS[compression]
    except KeyError:
        raise DamageError(f"compression {compression[:40]!r} is not known") from None
    out = inflater(data, size)
    if len(out) != size:
        raise DamageError("a chunk does not decompress to its declared size")
    return out


def inflate_part(compression: str, data: Any, limit: int) -> bytes:
    """As many bytes as a cut or damaged stream still gives, at most `limit`; never fails."""
    limit = min(limit, CHUNK_BYTES)
    feed = _FEEDERS.get(compression)
    if feed is None or limit <= 0:
        return b""
    step = feed()
    view, out, done = memoryview(data), [], 0
    # Small bites: what was decoded before the broken place is kept.
    for at in range(0, len(view), 4096):
        try:
            piece = step(bytes(view[at : at + 4096]))
        except _errors():
            break
        out.append(piece[: limit - done])
        done += len(out[-1])
        if done >= limit:
            break
    return b"".join(out)


def inflate_message(data: Any, limit: int = CHUNK_BYTES) -> bytes:
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


def _errors() -> tuple[type[BaseException], ...]:
    import zstandard

    return (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError)


def _zstd(data: Any, size: int) -> bytes:
    import zstandard

    context = getattr(_local, "zstd", None)
    if context is None:
        context = _local.zstd = zstandard.ZstdDecompressor()
    try:
        if zstandard.frame_content_size(data) not in (-1, size):
            raise DamageError("a chunk does not decompress to its declared size")
        out: bytes = context.decompress(data, max_output_size=size) if size else b""
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamageError("a zstd chunk does not decompress") from error
    return out


def _lz4(data: Any, size: int) -> bytes:
    import lz4.frame

    try:
        declared = lz4.frame.get_frame_info(data)["content_size"]
        if declared not in (0, size):
            raise DamageError("a chunk does not decompress to its declared size")
        if declared:
            out: bytes = lz4.frame.decompress(data)
        else:
            out = lz4.frame.LZ4FrameDecompressor().decompress(bytes(data), size + 1)
    except (RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamageError("an lz4 chunk does not decompress") from error
    return out


def _bz2(data: Any, size: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, size + 1)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise DamageError("a bz2 chunk does not decompress") from error


def _feed_zstd() -> Any:
    import zstandard

    return zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES).decompressobj().decompress


def _feed_lz4() -> Any:
    import lz4.frame

    return lz4.frame.LZ4FrameDecompressor().decompress


def _feed_bz2() -> Any:
    return bz2.BZ2Decompressor().decompress


_INFLATERS = {"zstd": _zstd, "lz4": _lz4, "bz2": _bz2}
_FEEDERS = {"zstd": _feed_zstd, "lz4": _feed_lz4, "bz2": _feed_bz2}
