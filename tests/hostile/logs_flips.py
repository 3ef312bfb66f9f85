"""One flipped bit anywhere in an otherwise sound log, per container."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from case import Case, Generator, without_index, writers

ODOMETRY = 600
EVERY = 10
ENDS = 3000
"""Bytes at both ends of a log: most of what holds it together."""


class Sound(NamedTuple):
    """A sound log: its bytes, how many messages it holds, and what it is called."""

    raw: bytes
    messages: int
    name: str


def _mcap(compression: str, *, bare: bool = False, chunked: bool = True) -> Sound:
    """bare: without index, statistics and checksums."""
    from mcap.writer import IndexType

    logs = writers()
    messages = logs.drive(ODOMETRY, EVERY)
    options: dict[str, Any] = {"enable_data_crcs": not bare, "use_chunking": chunked}
    if bare:
        options |= {"index_types": IndexType.NONE, "use_statistics": False, "enable_crcs": False}
        options |= {"use_summary_offsets": False, "repeat_channels": False}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        logs.mcap(path, messages, compression=compression, chunk_size=4096, **options)
        return Sound(path.read_bytes(), len(messages), "run.mcap")


def _bag(compression: str, *, indexed: bool = True) -> Sound:
    logs = writers()
    messages = logs.drive(ODOMETRY, EVERY)
    with TemporaryDirectory() as folder:
        path = logs.bag(Path(folder) / "run.bag", messages, compression, chunk=4096)
        raw = path.read_bytes()
    return Sound(raw if indexed else without_index(raw), len(messages), "run.bag")


def _db3() -> Sound:
    logs = writers()
    messages = logs.drive(ODOMETRY, EVERY)
    with TemporaryDirectory() as folder:
        made = logs.ros2_folder(Path(folder) / "run", messages)
        return Sound((made / "run.db3").read_bytes(), len(messages), "run.db3")


SOUND: dict[str, Callable[[], Sound]] = {
    "mcap-zstd": lambda: _mcap("ZSTD"),
    "mcap-none": lambda: _mcap("NONE"),
    "mcap-lz4-bare": lambda: _mcap("LZ4", bare=True),
    "mcap-unchunked-bare": lambda: _mcap("NONE", bare=True, chunked=False),
    "bag-none": lambda: _bag("none"),
    "bag-lz4": lambda: _bag("lz4"),
    "bag-bz2-active": lambda: _bag("bz2", indexed=False),
    "db3": _db3,
}


@cache
def sound(name: str) -> Sound:
    """A sound log, made once."""
    return SOUND[name]()


def one_bit(name: str, rng: random.Random, folder: Path) -> Case:
    """Half of the flips hit an end of the log: it is little, but can cost most."""
    log = sound(name)
    size = len(log.raw)
    end = rng.randrange(min(ENDS, size))
    at = rng.choice((end, size - 1 - end, rng.randrange(size), rng.randrange(size)))
    bit = rng.randrange(8)
    raw = bytearray(log.raw)
    raw[at] ^= 1 << bit
    path = folder / log.name
    path.write_bytes(raw)
    # A description, a head or a page may cost more than itself: it is skipped, not mended.
    return Case(path, 0, log.messages, f"{name}: bit {bit} of byte {at} flipped")


CASES: dict[str, Generator] = {f"flip-{name}": partial(one_bit, name) for name in SOUND}
