"""What a generator of hostile logs hands over, and what the generators share.

A module `logs_*.py` beside this file exposes `CASES: dict[str, Generator]`. A generator is called
with a seeded `random.Random` and an empty folder, writes one log below the folder, and says what is
true of it. The same seed gives the same bytes.
"""

from __future__ import annotations

import importlib.util
import random
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from topobatch.ingest.logs.messages import Findings


@dataclass(frozen=True)
class Case:
    """One hostile log.

    log: file or folder to read; intact: how many messages of the wanted topics are whole in it,
    lost: how many were written but are not whole any more; None where that cannot be known;
    note: what was done, for the report; kind: of sound log whose cost it is held against.
    """

    log: Path
    intact: int | None
    lost: int | None
    note: str
    kind: str = "detections"


Generator = Callable[[random.Random, Path], Case]


def writers() -> ModuleType:
    """The writers of small sound logs (`tests/ingest/log_writers.py`)."""
    name = "topobatch_test_ingest_log_writers"
    if name not in sys.modules:
        path = Path(__file__).parents[1] / "ingest" / "log_writers.py"
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


def read_of(path: Path) -> tuple[int, int, Findings]:
    """How many messages of the wanted types decode, how many do not; and what was met."""
    from topobatch.ingest.logs.intake import Intake, decoder_for
    from topobatch.ingest.logs.recording import recording_at
    from topobatch.ingest.logs.topics import JUNCTION_KINDS, ODOMETRY_KINDS

    types = {*ODOMETRY_KINDS, *JUNCTION_KINDS}
    intake = Intake(lambda channel: channel.type_name in types, decoder_for)
    recording = recording_at(path)
    for block in recording.blocks(intake.want):
        intake.take(block)
    for sink in intake.sinks:
        sink.flush()
    failed = sum(sink.failed for sink in intake.sinks)
    return sum(sink.messages for sink in intake.sinks) - failed, failed, recording.passes[-1]


def without_index(bag: bytes) -> bytes:
    """A bag without its index, as if its recorder had died."""
    index = struct.unpack_from("<Q", bag, bag.index(b"index_pos=") + 10)[0]
    return bag[:index].replace(struct.pack("<Q", index), bytes(8), 1)
