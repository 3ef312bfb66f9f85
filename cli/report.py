"""`topobatch report`: everything about a workspace on one page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import DataError, DocumentError, UsageError
from .draw import quiet_fonts, read_result
from .options import DEFAULT_WORKSPACE, MergeOption, WorkspaceOption
from .output import checked_output, complain, say
from .version import VERSION
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from ..topology.topomap import TopoMap

MOST_DRIVES = 3
"""Drives to record next with a picture: after one of them all others are worth another look."""

STANDS_ON = ("numpy", "scipy", "pydantic", "rosbags", "matplotlib", "rerun-sdk")


def report(
    out: Annotated[
        Path | None,
        typer.Argument(metavar="OUT.html", help="The page; default: report.html in the workspace."),
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    merge: MergeOption = MERGED,
) -> None:
    """Write a page about all runs and their merge, for a browser.

    One HTML file that needs nothing else and no network: how many sites the runs are of, the map,
    what to record next, undecided pairs with both placements, the verdict of every pair with its
    reason, how well each run was measured, settings and versions. Light or dark, as the browser
    asks.

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
    quiet_fonts()
    from ..merge.drives import drives
    from ..topology.files import write_text
    from ..viz.report import Report, report_page
    from .unchanged import changed_since, told_changed

    maps, unread = _maps(place)
    result = read_result(place) if place.merged_json.is_file() else None
    new = changed_since(place, result.info.get("maps") or {}, list(maps)) if result else []
    warnings = [*unread, *([f"Merge again: {told_changed(new)}"] if new else [])]
    locks = [str(lock) for lock in place.locks()]
    plan = drives(result, MOST_DRIVES) if result else ()
    html = report_page(Report(maps, result, warnings, locks, _versions(), plan))
    try:
        write_text(page, html)
    except PermissionError as error:
        raise DataError(f"{page}: {error.strerror}; name another OUT.html") from error
    say(f"{page}")
    if unread:
        raise typer.Exit(1)


def _maps(place: Workspace) -> tuple[dict[str, TopoMap], list[str]]:
    """The readable maps by run, and errors of the others."""
    maps, unread = {}, []
    for run in place.runs():
        try:
            maps[run] = place.read_map(run)
        except DocumentError as error:
            complain(f"{error}; left out")
            unread.append(f"The map of {run} cannot be read and is left out: {error}")
    return maps, unread


def _versions() -> list[tuple[str, str]]:
    from importlib.metadata import version
    from platform import python_version

    found = [(name, version(name)) for name in STANDS_ON]
    return [("topobatch", VERSION), ("Python", python_version()), *found]
