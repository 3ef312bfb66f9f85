"""`topobatch rename`: a run by another name."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Annotated

import typer

from ..topology.errors import UsageError
from .journal import note
from .merge import merge_again
from .options import DEFAULT_WORKSPACE, QuietOption, WorkspaceOption, complete_run
from .output import Screen
from .workspace import Workspace, checked_run_name

PIECE = re.compile(r"#[0-9]{1,9}")


def rename(
    old: Annotated[str, typer.Argument(metavar="OLD", help="A run.", autocompletion=complete_run)],
    new: Annotated[str, typer.Argument(metavar="NEW", help="Its new name.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    quiet: QuietOption = False,
) -> None:
    """Give a run another name.

    In its map, in locks and in the merges. Its pieces (RUN#2 and so on) are renamed with it. Its
    log, ingested again, goes by the new name. The recording of its map shows the old name until
    then; those of explanations are to be made anew, and exports stay as they are.

    \b
      topobatch rename run1 monday
    """
    place, screen = Workspace(workspace), Screen(quiet)
    checked_run_name(new)
    with place.held(screen.warn, make=False):
        names = _names(place, old, new)
        for before, after in names.items():
            _rename(place, before, after)
        place.rename_decided(lambda run: names.get(run, run))
        note(place, "rename", f"{old} → {new}", screen.warn)
        screen.line(f"{old} is {new} now")
        merge_again(place, names, screen, names)


def _names(place: Workspace, old: str, new: str) -> dict[str, str]:
    """New names by old ones, of a run and its pieces."""
    known = place.runs()
    if old not in known:
        place.chosen_runs([old], False)
    if "#" in new or PIECE.search(old):
        raise UsageError("pieces of a run are named after it (RUN#2): rename RUN, without any #")
    pieces = (run for run in known if run.startswith(old) and PIECE.fullmatch(run[len(old) :]))
    names = {run: f"{new}{run[len(old) :]}" for run in (old, *pieces)}
    taken = sorted(set(names.values()) & set(known))
    if taken:
        raise UsageError(f"there is a run {taken[0]!r} already")
    for name in names.values():
        checked_run_name(name)
        place.check_run(name)
    return names


def _rename(place: Workspace, old: str, new: str) -> None:
    """Move the files of a run; new ones are written before old ones are removed."""
    from ..topology.document import write_map
    from ..topology.files import write_atomically, write_json

    topomap = replace(place.read_map(old), run=new)
    if place.map_rrd(old).is_file() and not place.map_rrd(old).is_symlink():
        content = place.map_rrd(old).read_bytes()
        write_atomically(place.map_rrd(new), lambda path: path.write_bytes(content))
    write_map(place.map_json(new), topomap)
    record = place.ingested(old)
    if record is not None:
        listed = record.get("runs")
        runs = [r for r in listed if isinstance(r, str)] if isinstance(listed, list) else []
        moved = record | {"runs": [f"{new}{r[len(old) :]}" for r in runs if r.startswith(old)]}
        write_json(place.ingest_record(new), moved)
        # Told by its old name, the log is known to be this run (`ingest_worker`).
        write_json(place.ingest_record(old), {"renamed": new})
    for path in (*place.recordings_of(old), place.map_views(old), place.map_json(old)):
        path.unlink(missing_ok=True)
