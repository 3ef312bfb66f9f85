"""One flipped bit anywhere in an otherwise sound log, per container.

A message counts as lost if the bit lies in the message's own record or, where it lies in a
compressed or checksummed chunk, anywhere in that chunk: nothing tells which of its messages is hit.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from case import Case, Generator, without_index, writers

ODOMETRY = 600
EVERY = 10

HEAD = 48
"""So many bytes in front of a message's payload: its length, its number, its times."""


def recorded() -> list[Any]:
    """The messages of every log."""
    return list(writers().drive(ODOMETRY, EVERY))


class Span(NamedTuple):
    """Bytes [begin, end) of a file in which a flipped bit costs `held` messages."""

    begin: int
    end: int
    held: int


class Sound(NamedTuple):
    """A sound log: its bytes, where its messages are, how many there are, and what it is called."""

    raw: bytes
    spans: tuple[Span, ...]
    messages: int
    name: str


def _bare() -> dict[str, object]:
    from mcap.writer import IndexType

    return {
        "index_types": IndexType.NONE,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
    }


def _mcap(compression: str, *, bare: bool = False, crc: bool = True, chunked: bool = True) -> Sound:
    logs = writers()
    messages = recorded()
    options = _bare() if bare else {}
    with TemporaryDirectory() as folder:
        path = logs.mcap(
            Path(folder) / "run.mcap",
            messages,
            compression=compression,
            chunk_size=4096,
            enable_crcs=crc,
            enable_data_crcs=crc and not bare,
            use_chunking=chunked,
            **options,
        )
        raw = path.read_bytes()
    whole = compression != "NONE" or crc
    return Sound(raw, tuple(_mcap_spans(raw, whole and chunked)), len(messages), "run.mcap")


def _mcap_spans(raw: bytes, by_chunk: bool) -> list[Span]:
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk
    from mcap.stream_reader import breakup_chunk

    spans, position = [], 8
    while position + 9 <= len(raw):
        op, length = struct.unpack_from("<BQ", raw, position)
        end = position + 9 + length
        if op == 6:
            named = struct.unpack_from("<I", raw, position + 9 + 28)[0]
            data_at = position + 9 + 32 + named + 8
            if by_chunk:
                import io

                chunk = Chunk.read(ReadDataStream(io.BytesIO(raw[position + 9 : end])))
                held = sum(type(r).__name__ == "Message" for r in breakup_chunk(chunk))
                spans.append(Span(data_at, end, held))
            else:
                spans += _records(raw, data_at, end)
        elif op == 5:
            spans.append(Span(position, end, 1))
        elif op == 15:
            break
        position = end
    return spans


def _records(raw: bytes, position: int, end: int) -> list[Span]:
    spans = []
    while position < end:
        op, length = struct.unpack_from("<BQ", raw, position)
        if op == 5:
            spans.append(Span(position, position + 9 + length, 1))
        position += 9 + length
    return spans


def _bag(compression: str, *, indexed: bool = True) -> Sound:
    from rosbags.rosbag1 import Reader

    logs = writers()
    messages = recorded()
    with TemporaryDirectory() as folder:
        path = logs.bag(Path(folder) / "run.bag", messages, compression, chunk=4096)
        raw = path.read_bytes()
        with Reader(path) as reader:
            counts = [sum(info.connection_counts.values()) for info in reader.chunk_infos]
            starts = [info.pos for info in reader.chunk_infos]
    spans = []
    for start, held in zip(starts, counts, strict=True):
        header = struct.unpack_from("<I", raw, start)[0]
        data_at = start + 8 + header
        end = data_at + struct.unpack_from("<I", raw, data_at - 4)[0]
        if compression == "none":
            spans += _bag_records(raw, data_at, end)
        else:
            spans.append(Span(data_at, end, held))
    if not indexed:
        raw = without_index(raw)
    return Sound(raw, tuple(spans), len(messages), "run.bag")


def _bag_records(raw: bytes, position: int, end: int) -> list[Span]:
    spans = []
    while position < end:
        header = struct.unpack_from("<I", raw, position)[0]
        size = struct.unpack_from("<I", raw, position + 4 + header)[0]
        after = position + 8 + header + size
        if b"op=\x02" in raw[position + 4 : position + 4 + header]:
            spans.append(Span(position, after, 1))
        position = after
    return spans


def _db3() -> Sound:
    logs = writers()
    messages = recorded()
    with TemporaryDirectory() as folder:
        made = logs.ros2_folder(Path(folder) / "run", messages)
        raw = (made / "run.db3").read_bytes()
    store, at, spans = logs.store_of(False), 0, []
    for message in messages:
        payload = logs.payload(message, "cdr", store)
        at = raw.find(payload)
        if at >= 0:
            # The row's head: its lengths, its number, its topic and its time.
            spans.append(Span(at - 24, at + len(payload), 1))
    return Sound(raw, tuple(spans), len(messages), "run.db3")


SOUND: dict[str, Callable[[], Sound]] = {
    "mcap-zstd": lambda: _mcap("ZSTD"),
    "mcap-lz4": lambda: _mcap("LZ4"),
    "mcap-none": lambda: _mcap("NONE"),
    "mcap-none-nocrc": lambda: _mcap("NONE", crc=False),
    "mcap-zstd-bare": lambda: _mcap("ZSTD", bare=True),
    "mcap-lz4-bare": lambda: _mcap("LZ4", bare=True),
    "mcap-none-bare": lambda: _mcap("NONE", bare=True),
    "mcap-unchunked": lambda: _mcap("NONE", chunked=False),
    "mcap-unchunked-bare": lambda: _mcap("NONE", bare=True, chunked=False),
    "bag-none": lambda: _bag("none"),
    "bag-bz2": lambda: _bag("bz2"),
    "bag-lz4": lambda: _bag("lz4"),
    "bag-none-active": lambda: _bag("none", indexed=False),
    "bag-bz2-active": lambda: _bag("bz2", indexed=False),
    "bag-lz4-active": lambda: _bag("lz4", indexed=False),
    "db3": _db3,
}


@cache
def sound(name: str) -> Sound:
    """A sound log, made once."""
    return SOUND[name]()


def flipped(log: Sound, bit: int) -> tuple[bytes, int]:
    """The log's bytes with one bit changed, and how many messages that costs."""
    raw = bytearray(log.raw)
    raw[bit // 8] ^= 1 << bit % 8
    lost = sum(span.held for span in log.spans if span.begin <= bit // 8 < span.end)
    return bytes(raw), lost


def places(log: Sound) -> list[Span]:
    """The stretches of a log that hold no message: heads, indexes, the summary."""
    out, at = [], 0
    for span in sorted(log.spans):
        if span.begin > at:
            out.append(Span(at, span.begin, 0))
        at = max(at, span.end)
    if at < len(log.raw):
        out.append(Span(at, len(log.raw), 0))
    return out


def one_bit(name: str, rng: random.Random, folder: Path) -> Case:
    """Two thirds of the flips hit what holds the log together: it is little, but can cost most."""
    log, where = sound(name), rng.randrange(6)
    if where < 3:
        place = rng.choice(places(log))
        at = rng.randrange(place.begin, place.end)
    elif where == 3:
        head = rng.choice(log.spans)
        at = rng.randrange(head.begin, min(head.begin + HEAD, head.end))
    else:
        at = rng.randrange(len(log.raw))
    bit = 8 * at + rng.randrange(8)
    raw, _ = flipped(log, bit)
    path = folder / log.name
    path.write_bytes(raw)
    note = f"{name}: bit {bit % 8} of byte {at} flipped"
    # A description, a head or a page may cost more than itself: it is skipped, not mended.
    return Case(path, 0, log.messages, note, exact=False)


CASES: dict[str, Generator] = {f"flip-{name}": partial(one_bit, name) for name in SOUND}
