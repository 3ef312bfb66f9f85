"""`topobatch lock`: what a person knows about two runs."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import DataError, UsageError
from .journal import note
from .options import DEFAULT_WORKSPACE, WorkspaceOption, complete_run
from .output import confirmed, say, warn
from .workspace import Workspace

if TYPE_CHECKING:
    from ..merge.locks import Lock


def lock(
    a: Annotated[
        str | None, typer.Argument(metavar="A", help="A run.", autocompletion=complete_run)
    ] = None,
    b: Annotated[
        str | None, typer.Argument(metavar="B", help="Another run.", autocompletion=complete_run)
    ] = None,
    same: Annotated[
        bool, typer.Option("--same", help="The two share places: join them, where they fit best.")
    ] = False,
    never: Annotated[
        bool, typer.Option("--never", help="They share nothing: keep them apart, always.")
    ] = False,
    clear: Annotated[
        bool, typer.Option("--clear", help="Forget what was said about the two.")
    ] = False,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="JUNCTIONS",
            help="With --same: a junction of A and the junction of B that is the same place, by "
            'the numbers their maps give them: "3,7".',
        ),
    ] = None,
    yes: Annotated[
        bool,
        typer.Option(
            "--yes", "-y", help="Keep the lock whatever the maps say, without asking on a terminal."
        ),
    ] = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
) -> None:
    """Say that two runs belong together, or never do.

    Kept in the workspace (locks.json) and honoured by every later merge. Where the maps speak
    against --same (it may be another copy of the place, they contradict each other), that is shown
    first, and on a terminal asked back. Without runs, lists the locks.

    \b
      topobatch lock run1 run2 --same
      topobatch lock run1 run2 --same --at 3,7
      topobatch lock run1 run3 --never
      topobatch merge --all
    """
    place = Workspace(workspace)
    if a is None or b is None:
        if a is not None or same or never or clear or at is not None:
            raise UsageError("name two runs: topobatch lock A B --same (or --never, or --clear)")
        place.require()
        _show(place.locks())
        return
    if same + never + clear != 1:
        raise UsageError("say one of --same, --never and --clear")
    if at is not None and not same:
        raise UsageError("--at goes with --same")
    from ..merge.locks import Lock, with_lock, without_lock

    wanted = None if clear else Lock(a, b, "same" if same else "never", _pair(at))
    place.require()
    if wanted is not None:
        place.chosen_runs([a, b], False)
        _check(place, wanted)
        if not _confirmed(place, wanted, yes):
            raise typer.Exit(1)
    with place.held(warn, make=False):
        locks = place.locks()
        kept = without_lock(locks, a, b) if wanted is None else with_lock(locks, wanted)
        place.write_locks(kept)
        done = "clear" if wanted is None else wanted.decision
        note(place, "lock", f"{min(a, b)} + {max(a, b)}: {done}", warn)
    _show(kept)
    say(f"next: {place.call('merge', '--all')}")


def _confirmed(place: Workspace, lock: Lock, yes: bool) -> bool:
    """Whether a lock is to be kept, also if the maps of its runs speak against it."""
    from ..merge.robust.entries import doubt
    from .explain import decided

    if lock.decision == "never":
        return True
    try:
        *_, decision = decided(place, (lock.a, lock.b))
    except DataError as error:
        warn(f"what the maps say is not known: {error}")
        return True
    # The verdict of a merge may be by an older lock; the placement is that of the maps.
    best = decision.placements[0].alignment if decision.placements else decision.pair.best
    why = doubt(replace(decision.pair, best=best))
    if not why:
        return True
    warn(
        f"by the maps of {lock.a} and {lock.b}, {why}; see: {place.call('explain', lock.a, lock.b)}"
    )
    return yes or confirmed("lock them as the same?")


def _pair(at: str | None) -> tuple[int, int] | None:
    if at is None:
        return None
    found = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*", at)
    if found is None:
        raise UsageError(f'--at is {at!r}; it names a junction of A and one of B, like "3,7"')
    return int(found[1]), int(found[2])


def _check(place: Workspace, lock: Lock) -> None:
    """UsageError if the match of the runs was discarded, or a junction does not exist."""
    if lock.decision == "same" and (lock.a, lock.b) in place.discards():
        first = place.call("discard", f"{lock.a}:{lock.b}", "--undo")
        raise UsageError(f"the match of {lock.a} and {lock.b} was discarded; first: {first}")
    for run, vertex in zip((lock.a, lock.b), lock.at or (), strict=False):
        junctions = len(place.read_map(run))
        if vertex >= junctions:
            raise UsageError(f"{run} has junctions 0 … {junctions - 1}, not {vertex}")


def _show(locks: tuple[Lock, ...]) -> None:
    if not locks:
        say("no locks")
    for entry in locks:
        say(str(entry))
