"""`topobatch changes`: what is there in some runs and not in others."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import DocumentError
from ..topology.wording import counted, utc
from .options import (
    DEFAULT_WORKSPACE,
    ComponentOption,
    JsonOption,
    MergeOption,
    WorkspaceOption,
    complete_site,
)
from .output import say, say_lines
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from ..merge.change import Change, Witness


def changes(
    site: Annotated[
        str | None,
        typer.Argument(
            metavar="SITE",
            help="Only this site (topobatch list).",
            autocompletion=complete_site,
        ),
    ] = None,
    component: ComponentOption = None,
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
      topobatch site run1 north
      topobatch changes north
      topobatch changes --all --json
    """
    from ..merge.change import change_to_document
    from ..merge.changes import changes as changes_of

    place = Workspace(workspace, merge)
    document = place.read_merged()
    entries = {c.id: c for c in document.graph.components}
    names = {c.id: c.site or f"component {c.id}" for c in document.graph.components}
    component = place.component(document.graph, component, site)
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
        told = [change_to_document(c) | {"site": entries[c.component].site} for c in shown]
        say_lines(json.dumps(told))
        return
    for change in shown:
        for line in _lines(change, names[change.component]):
            say(line)
    unsure = sum(not c.sure for c in found)
    more = f", and {counted(unsure, 'difference')} that may be due to chance" if unsure else ""
    hint = " (--all shows them)" if unsure and not everything else ""
    say(
        f"{counted(len(found) - unsure, 'change')}{more}{hint}"
        if several
        else "no two runs were merged: nothing to compare"
    )


def _lines(change: Change, site: str) -> list[str]:
    """A change with its witnesses and its evidence."""
    x, y = change.xy
    at = f"at ({x:.1f}, {y:.1f}) m in {site}"
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
