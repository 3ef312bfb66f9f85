"""The journal of a workspace, `history.jsonl`, and `topobatch history`."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Annotated

from pydantic import TypeAdapter, ValidationError

from ..topology.errors import DataError
from ..topology.files import read_bytes, write_text
from ..topology.wording import counted
from .options import Extra, Here, JsonOption, verb
from .output import say, say_json, say_row, table, warn
from .workspace import Workspace


@dataclass(frozen=True, slots=True)
class Entry:
    """What was done, when."""

    time: str
    what: str
    text: str


ENTRY = TypeAdapter(Entry)


def note(place: Workspace, what: str, text: str) -> None:
    """Append a line; the caller holds the workspace's lock. A failure to write is only reported."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    line = json.dumps(asdict(Entry(now, what, text)))
    try:
        write_text(place.history, "".join(f"{each}\n" for each in [*_lines(place), line]))
    except (OSError, DataError) as error:
        warn(f"{place.history}: {error}; not noted")


def _lines(place: Workspace) -> list[str]:
    if not os.path.lexists(place.history):
        return []
    return read_bytes(place.history).decode("utf-8", "replace").splitlines()


def _entry(line: str) -> Entry | None:
    """A parsed line, None if it is no entry."""
    try:
        return ENTRY.validate_json(line)
    except ValidationError:
        return None


@verb
def history(
    place: Here,
    most: Annotated[
        int, "--last -n N", "Number of entries to show, the latest.", Extra(min=1)
    ] = 20,
    as_json: JsonOption = False,
) -> None:
    """Show what was done to the workspace.

    What was ingested, merged, locked, discarded and renamed, and when.

    \b
      topobatch history --last 5
    """
    place.require()
    lines = _lines(place)
    known = [entry for line in lines if (entry := _entry(line)) is not None]
    entries = known[-most:]
    if len(known) < len(lines):
        unread = counted(len(lines) - len(known), "line")
        warn(f"{place.history}: {unread} not written by topobatch, passed over")
    if as_json:
        say_json([asdict(entry) for entry in entries])
        return
    if not entries:
        say("nothing was done here yet")
        return
    rows = [(entry.time, entry.what, entry.text) for entry in entries]
    for line in table(("when", "what", ""), rows):
        say_row(line)
    if len(entries) < len(known):
        say(f"  ({len(known) - len(entries)} more: --last {len(known)})")
