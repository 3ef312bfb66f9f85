"""`topobatch report`: everything about a workspace on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Annotated

import typer

from ..merge.change import Change
from ..merge.changes import all_changes
from ..merge.decision import Decision
from ..merge.drives import drives, never_driven
from ..merge.result import MergeResult, Standing
from ..topology.errors import DocumentError, UsageError
from ..topology.topomap import TopoMap
from ..topology.wording import counted, listed
from .matching import kept_results, settings_of
from .next_drives import nothing_worth
from .options import HereWithMerge, QuietOption, verb
from .output import Advance, begin, checked_output, complain, progress, say, show, write_files
from .stale import changed_since, describe_changed
from .version import VERSION
from .workspace import MERGED, Workspace

MOST_EXPLAINED = 120
"""Pairs with their evidence line by line: a tenth of a second each. Of the others the page says
the verdict, its reason and the call that explains it."""

STANDS_ON = ("numpy", "scipy", "pydantic", "rosbags", "bokeh", "rerun-sdk")


@verb
def report(
    out: Annotated[
        Path | None, "OUT.html", "The page; default: report.html in the workspace."
    ] = None,
    *,
    place: HereWithMerge,
    quiet: QuietOption = False,
) -> None:
    """Write a page about all runs and their merge, for a browser.

    One HTML file that needs nothing else and no network: which runs are of which site, a map of
    each site with layers that can be moved and zoomed, what to record next, what changed, the
    verdict of every pair with both placements and the evidence, when each run was recorded, how
    well it was measured. Light or dark, as the browser asks.

    \b
      topobatch report
      topobatch report site.html
    """
    show(quiet=quiet)
    page = place.root / "report.html" if out is None else checked_output(out)
    if page.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{page}: a report's name ends in .html")
    if place.merge != MERGED:
        place.require_merge()
    if not place.runs():
        raise place.no_maps()
    from ..viz.report import Report, report_page  # which loads bokeh

    result = place.last_result()
    begin(f"reading {counted(len(place.runs()), 'map')} for {page}")
    with progress("reading maps", 0) as advance:
        maps, errors = place.read_maps(place.runs())
        for error in errors.values():
            complain(f"{error}; left out")
        notes = _notes(place, result, maps, errors)
        # Without a note, what follows from the maps that were merged can be worked out again.
        merged = None if notes else result
        changed = all_changes(merged, maps) if merged else []
        decisions = _decisions(place, merged, maps, changed, advance) if merged else {}
        advance(0, doing="drawing the page")
        found = drives(result) if result else ()
        lines = nothing_worth(result, never_driven(result), place) if result and not found else ()
        html = report_page(
            Report(
                maps=maps,
                result=result,
                warnings=notes,
                locks=[str(lock) for lock in place.locks()],
                versions=[
                    ("topobatch", VERSION),
                    ("Python", python_version()),
                    *((name, version(name)) for name in STANDS_ON),
                ],
                drives=found,
                unexplored=lines,
                changes=changed,
                decisions=decisions,
                where=place.where,
                as_merged=merged is not None,
            )
        )
    write_files({page: html})
    say(f"{page}")
    if result is None:
        say(f"not merged yet: {place.call('merge', '--all')}")
    if errors:
        raise typer.Exit(1)


def _notes(
    place: Workspace,
    result: MergeResult | None,
    maps: Mapping[str, TopoMap],
    errors: Mapping[str, DocumentError],
) -> list[str]:
    """In what the maps are not those that were merged. errors: why some cannot be read."""
    unreadable = "The map of {} cannot be read and is left out: {}"
    notes = [unreadable.format(run, error) for run, error in errors.items()]
    if result is not None:
        if new := changed_since(place, result, list(maps)):
            notes.append(f"Merge again: {describe_changed(new)}")
        if gone := sorted(result.home.keys() - maps.keys() - errors.keys()):
            notes.append(f"Merge again: no map is there any more of {listed(gone, 3)}")
    return notes


def _decisions(
    place: Workspace,
    result: MergeResult,
    maps: Mapping[str, TopoMap],
    changed: Sequence[Change],
    advance: Advance,
) -> dict[tuple[str, str], Decision]:
    """The evidence term by term of the pairs that a reader asks about first: undecided ones, then
    the merged ones with the least evidence; each with what changed between the two."""
    from ..merge.robust.explained import Merge, explain

    if result.info.get("method") == "paper":
        return {}
    open_ = [v for v in result.verdicts if v.standing in (Standing.AMBIGUOUS, Standing.KEPT_OUT)]
    merged = [v for v in result.verdicts if v.standing is Standing.MERGED]
    open_.sort(key=lambda v: (-v.evidence_bits, v.a, v.b))
    merged.sort(key=lambda v: (v.evidence_bits, v.a, v.b))
    settings = settings_of(place, result).robust
    kept = kept_results(place, settings)
    merge = Merge.of(result, maps.__getitem__, settings, place.locks(), kept)
    chosen = [*open_, *merged][:MOST_EXPLAINED]
    home, out = result.component_of, {}
    for done, v in enumerate(chosen):
        advance(done, f"{done} of {counted(len(chosen), 'pair')}", "explaining")
        decision = explain(merge, v.a, v.b)
        between = (c for c in changed if c.sure and c.differs_for(v.a, v.b))
        notes = (c.words(home[v.a].name)[0] for c in between)
        out[v.a, v.b] = replace(decision, notes=(*decision.notes, *notes))
    return out
