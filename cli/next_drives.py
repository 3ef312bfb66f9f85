"""`topobatch next`: what to record next."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import DataError, UsageError
from .options import (
    DEFAULT_WORKSPACE,
    JsonOption,
    MergeOption,
    WorkspaceOption,
    complete_site,
)
from .output import folded, say, say_lines
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from ..merge.drive import Drive

PLANS = (".csv", ".geojson")
"""Suffixes of files of waypoints."""


def next_drives(
    site: Annotated[
        str | None,
        typer.Argument(
            metavar="SITE",
            help="Only drives that begin at this site, or join it.",
            autocompletion=complete_site,
        ),
    ] = None,
    most: Annotated[
        int, typer.Option("--drives", "-n", metavar="N", min=1, help="How many drives to list.")
    ] = 5,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE.csv|FILE.geojson",
            help="Also write the waypoints there; may be given twice.",
        ),
    ] = None,
    merge: MergeOption = MERGED,
    as_json: JsonOption = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
) -> None:
    """Tell what to record next, so that more runs come together.

    A few drives, best first: where each begins, which way it goes, how many metres, and what it
    would settle. Two sites with an ambiguous pair of runs are joined by one drive through enough
    places of both, as the pair's best placement has them. Where no pair is open, a drive leads into
    the unknown, by a branch that nobody drove. Drives are ranked by the evidence that they are
    expected to bring, in bits for each metre. Junctions have the numbers of merged.json, which
    topobatch draw SITE shows; SITE:9 is junction 9 of another site. After the drive: ingest its
    log, and merge again.

    \b
      topobatch next
      topobatch next --drives 1 --output plan.csv --output plan.geojson
    """
    for path in output or ():
        if path.suffix.lower() not in PLANS:
            raise UsageError(f"{path}: a plan's name ends in .csv or .geojson")
    place = Workspace(workspace, merge)
    result = place.read_result()
    from ..merge.drives import drives
    from ..merge.result import Standing

    names = {c.name: c.id for c in result.components}
    if site is not None and site not in names:
        raise place.no_site(site, list(names))
    found = drives(result, most, None if site is None else names[site])
    for path in output or ():
        _write(path, found)
    if as_json:
        from ..merge.drive import drive_to_document

        say_lines(json.dumps([drive_to_document(d) for d in found]))
        return
    if found and not result.standings()[Standing.AMBIGUOUS]:
        hardly = ", and would hardly join sites" if max(d.bits for d in found) < HARDLY_BITS else ""
        say(f"no pair is open; these drives lead to branches that nobody drove{hardly}")
    for line in _lines(found):
        say(line)
    if found:
        say("after the drive, ingest its log and merge again; waypoints: --output plan.csv")
        say(f"on the map, with numbers: {place.call('report', *place.named)}")
    for path in output or ():
        say(f"{path}")


HARDLY_BITS = 1.0
"""Evidence that does not even make a match twice as likely."""


def _lines(found: Sequence[Drive]) -> list[str]:
    if not found:
        return ["nothing to record: no pair of runs is open, and every branch was driven"]
    out = []
    for k, drive in enumerate(found, 1):
        where, settles = drive.words
        expected = f"{drive.bits:.1f} bits expected, {drive.bits_per_m:.3f} a metre"
        out += folded(f"{k}. {where}", indent="   ")
        for line in (f"{settles}; {expected}", drive.way):
            out += folded(f"   {line}", indent="   ")
    return out


def _write(path: Path, found: Sequence[Drive]) -> None:
    from ..topology.files import write_text
    from ..viz.exports.drives import drives_csv, drives_geojson

    text = drives_csv(found) if path.suffix.lower() == PLANS[0] else drives_geojson(found)
    try:
        write_text(path, text)
    except PermissionError as error:
        raise DataError(f"{path}: {error.strerror}; name another --output") from error
