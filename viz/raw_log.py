"""A raw log as a recording that the viewer opens beside the map of its run."""

from __future__ import annotations

from pathlib import Path

from rerun.chunk import Chunk, McapReader

from ..topology.errors import LogError
from ..topology.files import write_atomically
from .recording import APPLICATION_ID

LOG = "/log"
"""Topics lie below this: a topic /map is not the map of ours."""

MAGIC = b"\x89MCAP0\r\n"


def write(path: Path, log: Path, run: str) -> None:
    """Write the recording of a raw log; see `topobatch.viz.write_raw_log`."""
    files = sorted(log.glob("*.mcap")) if log.is_dir() else [log]
    if not files or not all(map(_is_mcap, files)):
        raise LogError(
            f"{log}: the viewer reads raw logs in MCAP only; look at the map without --with-log"
        )

    def save(temporary: Path) -> None:
        try:
            streams = [McapReader(file).stream().map(_below) for file in files]
            first, *more = streams
            both = first.merge(*more) if more else first
            both.write_rrd(temporary, application_id=APPLICATION_ID, recording_id=run)
        except ValueError as error:
            raise LogError(
                f"{log}: the viewer cannot read it: {error}; `mcap recover` may mend it"
            ) from error

    write_atomically(path, save)


def _is_mcap(file: Path) -> bool:
    with file.open("rb") as opened:
        return opened.read(len(MAGIC)) == MAGIC


def _below(chunk: Chunk) -> Chunk:
    return chunk.with_entity_path(f"{LOG}{chunk.entity_path}")
