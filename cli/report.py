"""`topobatch report`: everything about a workspace on one page."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import DataError, UsageError
from ..topology.wording import counted
from .explain import settings_of
from .matching import kept_results
from .options import DEFAULT_WORKSPACE, MergeOption, WorkspaceOption
from .output import Screen, checked_output, complain, say
from .version import VERSION
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..merge.change import Change
    from ..merge.decision import Decision
    from ..merge.result import MergeResult
    from ..topology.topomap import TopoMap
    from .output import Advance

MOST_DRIVES = 3
"""Drives to record next: after one of them all others are worth another look."""

MOST_EXPLAINED = 120
"""Pairs with their evidence line by line: a tenth of a second each. Of the others the page says
the verdict, its reason and the call that explains it."""

STANDS_ON = ("numpy", "scipy", "pydantic", "rosbags", "bokeh", "rerun-sdk")


def report(
    out: Annotated[
        Path | None,
        typer.Argument(metavar="OUT.html", help="The page; default: report.html in the workspace."),
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    merge: MergeOption = MERGED,
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
    place = Workspace(workspace, merge)
    page = place.root / "report.html" if out is None else checked_output(out)
    if page.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{page}: a report's name ends in .html")
    if merge != MERGED:
        place.require_merge()
    if not place.runs():
        raise place.no_maps()
    from ..merge.drives import drives
    from ..topology.files import write_text
    from ..viz.report import Report, report_page
    from .unchanged import changed_since, told_changed

    result = place.read_result() if place.merged_json.is_file() else None
    screen = Screen(quiet=False)
    screen.begin(f"reading {counted(len(place.runs()), 'map')} for {page}")
    with screen.progress("reading maps", 0) as advance:
        maps, errors = place.read_maps(place.runs())
        for error in errors.values():
            complain(f"{error}; left out")
        told = "The map of {} cannot be read and is left out: {}"
        unread = [told.format(run, error) for run, error in errors.items()]
        new = changed_since(place, result.info.get("maps") or {}, list(maps)) if result else []
        same = result is not None and not new and not unread
        decisions = _decisions(place, result, maps, advance) if result and same else {}
        advance(0, doing="drawing the page")
        html = report_page(
            Report(
                maps,
                result,
                [*unread, *([f"Merge again: {told_changed(new)}"] if new else [])],
                [str(lock) for lock in place.locks()],
                _versions(),
                drives(result, MOST_DRIVES) if result else (),
                _changes(result, maps) if result and same else (),
                decisions=decisions,
                where=place.where,
                as_merged=same,
            )
        )
    try:
        write_text(page, html)
    except PermissionError as error:
        raise DataError(f"{page}: {error.strerror}; name another OUT.html") from error
    say(f"{page}")
    if result is None:
        say(f"not merged yet: {place.call('merge', '--all')}")
    if unread:
        raise typer.Exit(1)


def _changes(result: MergeResult, maps: Mapping[str, TopoMap]) -> list[Change]:
    """What changed between the runs of every site."""
    from ..merge.changes import changes

    several = (c for c in result.components if len(c.poses) > 1)
    found = (changes(result, c.id, {run: maps[run] for run in c.poses}) for c in several)
    return list(chain.from_iterable(found))


def _decisions(
    place: Workspace, result: MergeResult, maps: Mapping[str, TopoMap], advance: Advance
) -> dict[tuple[str, str], Decision]:
    """The evidence term by term of the pairs that a reader asks about first: undecided ones, then
    the merged ones with the least evidence."""
    from ..merge.result import Standing
    from ..merge.robust.explained import Merge, explain

    document = place.read_merged()
    if document.graph.method == "paper":
        return {}
    first = (Standing.AMBIGUOUS, Standing.KEPT_OUT)
    open_ = [v for v in result.verdicts if v.standing in first]
    merged = [v for v in result.verdicts if v.standing is Standing.MERGED]
    open_.sort(key=lambda v: (-v.evidence_bits, v.a, v.b))
    merged.sort(key=lambda v: (v.evidence_bits, v.a, v.b))
    settings = settings_of(place, document)
    kept = kept_results(place, settings, complain)
    merge = Merge.of(result, maps.__getitem__, settings, place.locks(), kept)
    chosen = [*open_, *merged][:MOST_EXPLAINED]
    out = {}
    for done, v in enumerate(chosen):
        advance(done, f"{done} of {counted(len(chosen), 'pair')}", "explaining")
        out[v.a, v.b] = explain(merge, v.a, v.b)
    return out


def _versions() -> list[tuple[str, str]]:
    from importlib.metadata import version
    from platform import python_version

    found = [(name, version(name)) for name in STANDS_ON]
    return [("topobatch", VERSION), ("Python", python_version()), *found]
