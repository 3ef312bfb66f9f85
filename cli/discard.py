"""`topobatch discard`: a run, or the match of two, as if it had never been (§4.1)."""

from __future__ import annotations

from typing import Annotated

import typer

from ..topology.errors import DataError, DocumentError, UsageError
from ..topology.wording import listed
from .journal import note
from .merge import merge_again
from .options import DEFAULT_WORKSPACE, QuietOption, WorkspaceOption, complete_run
from .output import Screen
from .workspace import Workspace, pair_named


def discard(
    what: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RUN|A:B",
            help="Runs, or matches of two runs.",
            autocompletion=complete_run,
        ),
    ] = None,
    undo: Annotated[bool, typer.Option("--undo", help="Let the matches A:B count again.")] = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    quiet: QuietOption = False,
) -> None:
    """Take back runs, or matches of two runs.

    What depends on them goes with them. RUN: its map, recordings, exports and locks are removed;
    its log, ingested again, makes it anew. A:B: what was found between the two is not counted any
    more, in the merges that there are and in later ones; other runs may still join them (to keep
    them apart whatever is found: topobatch lock A B --never). Merges that hold any of the runs are
    made anew without it. Without arguments, lists the matches that were taken back.

    \b
      topobatch discard run1:run2
      topobatch discard run1:run2 --undo
      topobatch discard run3
    """
    place, screen = Workspace(workspace), Screen(quiet)
    if not what:
        if undo:
            raise UsageError("--undo: name the matches, A:B")
        place.require()
        taken_back = sorted(place.discards())
        for a, b in taken_back:
            screen.line(f"{a}:{b}")
        if not taken_back:
            screen.line("no matches were taken back")
        return
    with place.held(screen.warn, make=False):
        runs, pairs = _sorted_out(place, what, undo)
        if pairs:
            before = place.discards()
            place.write_discards(before - set(pairs) if undo else before | set(pairs))
        for run in runs:
            _discard_run(place, run)
        names = [*runs, *(f"{a}:{b}" for a, b in pairs)]
        verb = "counted again" if undo else "discarded"
        note(place, "discard", f"{verb}: {listed(names)}", screen.warn)
        screen.line(f"{verb}: {listed(names)}")
        merge_again(place, {*runs, *(run for pair in pairs for run in pair)}, screen)


def _sorted_out(
    place: Workspace, what: list[str], undo: bool
) -> tuple[list[str], list[tuple[str, str]]]:
    """The runs and the pairs that are named; UsageError for unknown ones, DataError for files in
    place of maps."""
    known = set(place.runs())
    runs, pairs = [], []
    for name in dict.fromkeys(what):
        if name in known and not undo:
            runs.append(name)
            continue
        pair = pair_named(name, known)
        if pair is None or pair[0] == pair[1]:
            raise place.unknown([name], f"{'two runs A:B' if undo else 'run or runs A:B'} named")
        pairs.append(pair)
    _check_locks(place, pairs, undo)
    for run in runs:
        _check_own(place, run)
    return runs, pairs


def _check_own(place: Workspace, run: str) -> None:
    """DataError if topobatch did not write `maps/<run>.json`; of a damaged one the recording beside
    it tells."""
    from ..topology.files import read_json

    path = place.map_json(run)
    try:
        found = read_json(path)
    except DocumentError:
        found = None
    schema = found.get("schema") if isinstance(found, dict) else None
    if not str(schema).startswith("topobatch.map/") and not place.map_rrd(run).is_file():
        raise DataError(f"{path}: is no map of topobatch's; it is left where it is")


def _check_locks(place: Workspace, pairs: list[tuple[str, str]], undo: bool) -> None:
    """UsageError for pairs locked as the same, or if there is nothing to undo."""
    if undo:
        kept = place.discards()
        for a, b in pairs:
            if (a, b) not in kept:
                raise UsageError(f"the match {a}:{b} was not discarded")
        return
    same = {(lock.a, lock.b) for lock in place.locks() if lock.decision == "same"}
    for a, b in pairs:
        if (a, b) in same:
            first = place.call("lock", a, b, "--clear")
            raise UsageError(f"{a} and {b} are locked as the same; first: {first}")


def _discard_run(place: Workspace, run: str) -> None:
    """Remove a run's files, its map last, so that an interrupted call can be repeated."""
    place.rename_decided(lambda each: None if each == run else each)
    made = (*place.recordings_of(run), *place.exports_of(run), place.map_views(run))
    for path in (place.ingest_record(run), *made, place.map_json(run)):
        path.unlink(missing_ok=True)
