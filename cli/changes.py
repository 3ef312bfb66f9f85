"""`topobatch changes`: what is there in some runs and not in others."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import DocumentError
from ..topology.wording import counted, utc
from .options import DEFAULT_WORKSPACE, JsonOption, MergeOption, WorkspaceOption
from .output import say, say_lines
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from ..merge.changes import Change, Witness


def changes(
    component: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Only this component of the merged map.")
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Also differences that may be due to chance.")
    ] = False,
    merge: MergeOption = MERGED,
    as_json: JsonOption = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
) -> None:
    """Tell what changed between the runs that were merged.

    Corridors and junctions that one run found and another did not, although it passed an end of the
    corridor, or drove through the place of the junction: gone, new, or there at times. For each
    the runs, how often and when they passed, and the evidence in bits: how unlikely it is that the
    others only missed it.

    \b
      topobatch changes
      topobatch changes --all --json
    """
    from ..merge.changes import change_to_document
    from ..merge.changes import changes as changes_of

    place = Workspace(workspace, merge)
    document = place.read_merged()
    entries = {c.id: c for c in document.graph.components}
    if component is not None and component not in entries:
        raise place.no_component(component, list(entries))
    found: list[Change] = []
    several = 0
    for number, entry in entries.items():
        if len(entry.runs) < 2 or component not in (None, number):
            continue
        several += 1
        maps = place.maps_as_merged(document, number, sorted(entry.runs))
        try:
            found += changes_of(document, number, maps)
        except ValueError as error:
            raise DocumentError(f"{place.merged_json}: component {number}: {error}") from error
    shown = [c for c in found if everything or c.sure]
    if as_json:
        say_lines(json.dumps([change_to_document(c) for c in shown]))
        return
    for change in shown:
        for line in _lines(change):
            say(line)
    unsure = sum(not c.sure for c in found)
    told = f", and {counted(unsure, 'difference')} that may be due to chance" if unsure else ""
    hint = " (--all shows them)" if unsure and not everything else ""
    say(
        f"{counted(len(found) - unsure, 'change')}{told}{hint}"
        if several
        else "no two runs were merged: nothing to compare"
    )


def _lines(change: Change) -> list[str]:
    """A change with its witnesses and its evidence."""
    x, y = change.xy
    at = f"at ({x:.1f}, {y:.1f}) m in component {change.component}"
    if change.thing == "corridor":
        u, v = change.junctions
        what = f"corridor of {change.length:.1f} m between junctions {u} and {v}, {at}"
    else:
        what = f"junction {change.junctions[0]}, {at}"
    verb = {"gone": "gone", "new": "new", "differs": "now and then"}[str(change.kind)]
    sure = "" if change.sure else "perhaps "
    needed = "needed" if change.sure else "would be needed"
    return [
        f"{sure}{verb}: {what}",
        *(f"  passed by {_told(w)}" for w in change.there),
        *(f"  not there for {_told(w)}" for w in change.missing),
        f"  evidence {change.bits:.1f} bits, {change.needed:.1f} {needed}",
    ]


def _told(witness: Witness) -> str:
    """Who, how often, when (UTC)."""
    first, last = (utc(t, "%Y-%m-%d %H:%M") for t in (witness.first_ns, witness.last_ns))
    when = first if first == last else f"{first} to {last}"
    return f"{witness.run}, {counted(witness.passes, 'pass', 'passes')}, {when}"
