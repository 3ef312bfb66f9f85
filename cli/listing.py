"""`topobatch list`: the runs of a workspace."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import chain

import numpy as np
import typer

from ..ingest.remote.path import is_remote
from ..merge.decision_text import weakest_links
from ..merge.result import Component, MergeResult
from ..topology.errors import DataError
from ..topology.wording import counted, utc
from .options import Here, JsonOption, verb
from .output import complain, say, say_folded, say_json, say_row, table, warn
from .stale import changed_since, locked_since
from .version import VERSION
from .workspace import Workspace

ISO = "%Y-%m-%dT%H:%M:%S+00:00"


@dataclass(frozen=True, slots=True)
class Listed:
    """A run. health: "ok", its warnings in short, or why its map cannot be read; component, runs,
    site: its component in the last merge, the number of runs in it, and its name; recorded: time of
    its first junction pass, ingested: when its map was made, in UTC; stale: what changed since."""

    run: str
    junctions: int | None = None
    corridors: int | None = None
    length_m: float | None = None
    health: str = "ok"
    component: int | None = None
    runs: int | None = None
    recorded: str | None = None
    ingested: str = ""
    stale: tuple[str, ...] = ()
    site: str | None = None


@verb
def list_runs(place: Here, as_json: JsonOption = False) -> None:
    """List the runs of the workspace, by site.

    The sites of the last merge by name, each with its junctions and corridors; their names
    are what draw, export and changes take (topobatch site gives others). Of every run how large its
    map is and what is wrong with it, when the robot first passed a junction (its log may begin
    earlier), and what is stale: maps and locks that changed since the merge, logs that changed or
    were read by another version. The exit code is 1 if a map cannot be read.

    \b
      topobatch list
      topobatch list --json
    """
    merged, locked = None, set[str]()
    with _listed_without("it"):
        merged = place.last_result()
    with _listed_without("locks"):
        locked = {*chain(*locked_since(place, merged))} if merged else locked
    home = merged.component_of if merged else {}
    rows = [
        _listed(place, run, merged, home.get(run), locked=run in locked) for run in place.runs()
    ]
    if not rows:
        raise place.no_maps()
    if as_json:
        say_json([asdict(row) for row in rows])
    else:
        _show(rows, _sizes(merged) if merged else {}, gone=len(home.keys() - {r.run for r in rows}))
    unreadable = sum(row.junctions is None for row in rows)
    if unreadable:
        complain(f"{counted(unreadable, 'map')} cannot be read")
        raise typer.Exit(1)


def _show(rows: Sequence[Listed], sizes: Mapping[int, str], gone: int) -> None:
    """Print the runs below their sites. sizes: of components, in words; gone: merged runs that are
    not here any more."""
    head = ("run", "junctions", "corridors", "first pass (UTC)", "health", "stale")
    first, *lines = table(head, [_row(row) for row in rows])
    say_row(first)
    for title, own in _by_site(rows, sizes):
        say_folded(title, indent="    ")
        for k in own:
            say_row(lines[k])
    if gone:
        say(f"in the last merge, but not here any more: {counted(gone, 'run')}")
    stale = sum(bool(row.stale) for row in rows)
    say(f"{counted(len(rows), 'run')}{f', {stale} stale' if stale else ''}")


def _row(row: Listed) -> tuple[str, ...]:
    junctions = "?" if row.junctions is None else f"{row.junctions:,}"
    corridors = "?" if row.corridors is None else f"{row.corridors:,} ({row.length_m:,.0f} m)"
    recorded = (row.recorded or "?")[:16].replace("T", " ")
    return (row.run, junctions, corridors, recorded, row.health, "; ".join(row.stale))


def _by_site(rows: Sequence[Listed], sizes: Mapping[int, str]) -> list[tuple[str, list[int]]]:
    """Titles, each with the numbers of the rows below it: the sites of several runs by
    name; runs that are alone; runs that were not merged. sizes: of components, in words."""
    groups: dict[tuple[int, str, str], list[int]] = {}
    for k, row in enumerate(rows):
        if row.component is None:
            key = (2, "", "not merged")
        elif row.runs == 1 and row.site in (None, row.run):
            key = (1, "", "alone")
        else:
            called = row.site or f"component {row.component}"
            size = sizes.get(row.component, "")
            key = (0, called, f"{called}: {counted(row.runs or 0, 'run')}{size}")
        groups.setdefault(key, []).append(k)
    return [(title, own) for (*_, title), own in sorted(groups.items())]


@contextmanager
def _listed_without(what: str) -> Iterator[None]:
    """Say of what cannot be read that the runs are listed without it."""
    try:
        yield
    except DataError as error:
        warn(f"{error}; listed without {what}")


def _sizes(result: MergeResult) -> dict[int, str]:
    """Junctions and corridors of every component; of several, the numbers of its junctions, which
    follow each other, and its weakest link."""
    weakest, fused, out = weakest_links(result.verdicts, result.home), result.fused, {}
    for c in result.components:
        rows = np.flatnonzero((fused.component == c.id) & ~fused.is_turned)
        lengths = fused.length[np.isin(fused.source, rows) & np.isin(fused.target, rows)]
        ways = f"{counted(len(lengths), 'corridor')} ({lengths.sum():,.0f} m)"
        many = len(result.components) > 1 and len(rows) > 1
        between = f" (numbers {rows.min()} to {rows.max()})" if many else ""
        out[c.id] = f", {counted(len(rows), 'junction')}{between}, {ways}{weakest.get(c.id, '')}"
    return out


def _listed(
    place: Workspace, run: str, merged: MergeResult | None, home: Component | None, *, locked: bool
) -> Listed:
    """home: the run's component in the last merge; locked: a lock of it changed since then."""
    made_ns = os.lstat(place.maps / f"{run}.json").st_mtime_ns
    old = []
    if merged is not None and home is None:
        old.append("not merged")
    elif merged is not None and changed_since(place, merged, [run]):
        old.append("map changed since the merge")
    if locked:
        old.append("lock changed: merge again")
    row = Listed(run, ingested=utc(made_ns, ISO), stale=tuple(old))
    if home is not None:
        row = replace(row, component=home.id, runs=len(home.poses), site=home.site or None)
    try:
        m = place.read_map(run)
    except (DataError, OSError) as error:
        return replace(row, health=f"unreadable: {error}")
    times = m.observation_time_ns
    if warnings := m.info.get("warnings"):
        # What the first is about, without its figures and what was done about it.
        about = re.split(r"[;:(]", warnings[0])[0].strip()
        more = "; …" if len(warnings) > 1 else ""
        row = replace(row, health=f"{counted(len(warnings), 'warning')}: {about}{more}")
    return replace(
        row,
        junctions=len(m),
        corridors=len(m.source),
        length_m=round(float(m.length.sum()), 3),
        recorded=utc(int(times.min()), ISO) if len(times) else None,
        stale=(*old, *_log_changes(place, run)),
    )


def _log_changes(place: Workspace, run: str) -> list[str]:
    """How a run's log changed since it was read, by its record."""
    record, out = place.ingested(run), []
    if record.version not in (None, VERSION):
        out.append("made by another version")
    if record.log is not None and record.bytes not in (None, _size(record.log, record.bytes)):
        out.append("log changed, or gone")
    return out


def _size(log: str, known: int | None) -> int | None:
    """The size of a log's file, None without any; the known one of folders, and of remote logs: a
    list does not wait for servers. It is not opened, since a record can name any file."""
    if is_remote(log):
        return known
    try:
        found = os.stat(log)
    except (OSError, ValueError):
        return None
    return found.st_size if stat.S_ISREG(found.st_mode) else known
