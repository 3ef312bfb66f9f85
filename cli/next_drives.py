"""`topobatch next`: what to record next."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Annotated

from ..merge.drive import Drive, Undriven, drive_to_document
from ..merge.drives import drives, never_driven
from ..merge.result import Component, MergeResult, Standing
from ..topology.errors import UsageError
from ..topology.wording import counted
from ..viz.exports.drives import drives_csv, drives_geojson
from .draw import merge_picture, picture_form
from .options import Extra, HereWithMerge, JsonOption, ThemeOption, verb
from .output import checked_output, folded, say, say_folded, say_json, write_files
from .workspace import Workspace

PLANS, PICTURES = (".csv", ".geojson"), (".svg", ".png")
"""Suffixes of files of waypoints, and of pictures."""


@verb
def next_drives(
    site: Annotated[
        str | None, "SITE|RUN", "Only drives that begin at this site, or join it."
    ] = None,
    most: Annotated[int, "--drives -n N", "How many drives to list.", Extra(min=1)] = 5,
    output: Annotated[
        list[Path] | None,
        "--output -o FILE",
        "Also write the plan there: a picture (.svg, .png), or its waypoints (.csv, .geojson); may "
        "be given several times.",
    ] = None,
    theme: ThemeOption = "light",
    *,
    place: HereWithMerge,
    as_json: JsonOption = False,
) -> None:
    """Tell what to record next, so that more runs come together.

    A few drives, best first: where each begins, which way it goes, how many metres, and what it
    would settle. Two sites with an ambiguous pair of runs are joined by one drive through enough
    places of both, as the pair's best placement has them. Where no pair is open, a drive leads into
    the unknown, by a branch that nobody drove. Drives are ranked by the evidence that they are
    expected to bring, in bits for each metre; below one bit none is proposed. Then a line says so,
    and the branches that nobody drove are listed, also in GeoJSON (kind "undriven").
    Junctions have the numbers of merged.json, which the picture shows; SITE:9 is junction 9 of
    another site. After the drive: ingest its log, and merge again.

    \b
      topobatch next
      topobatch next -o plan.svg -o plan.geojson
    """
    for path in output or ():
        if checked_output(path).suffix.lower() not in PLANS + PICTURES:
            raise UsageError(f"{path}: a plan's name ends in .svg, .png, .csv or .geojson")
    result = place.read_result()
    component = place.component(result, site)
    found = drives(result, most, component)
    about = next((c for c in result.components if c.id == component), None)
    shown = {c.name for c in result.components} if about is None else {about.name}
    left = [] if found else [b for b in never_driven(result) if b.site in shown]
    plans = {p: _plan(p, found, left, result, shown, place, theme) for p in output or ()}
    write_files(plans)
    if as_json:
        say_json([drive_to_document(d) for d in found])
        return
    if not found:
        for line in nothing_worth(result, left, place, about):
            say_folded(line, indent="  ")
    for line in _lines(found, result, place, about) if found else ():
        say(line)
    for path in output or ():
        say(f"{path}")
    if not output:
        named = () if site is None else (site,)
        plan = place.call("next", *named, *place.of_merge, "-o", "plan.svg")
        say(f"on a map with numbers: {plan} (waypoints: plan.geojson{', plan.csv' * bool(found)})")


def _lines(
    found: Sequence[Drive], result: MergeResult, place: Workspace, about: Component | None
) -> list[str]:
    out = []
    if all(drive.onto is None for drive in found):
        why = _not_to_settle(result, place, about) or _none_open(about)
        out += folded(f"{why}; these drives lead to branches that nobody drove", indent="  ")
    for k, drive in enumerate(found, 1):
        where, settles = drive.words
        expected = f"{drive.bits:.1f} bits expected, {drive.bits_per_m:.3f} a metre"
        out += folded(f"{k}. {where}", indent="   ")
        for line in (f"{settles}; {expected}", drive.way):
            out += folded(f"   {line}", indent="   ")
    return [*out, "after the drive, ingest its log and merge again"]


def nothing_worth(
    result: MergeResult, left: Iterable[Undriven], place: Workspace, about: Component | None = None
) -> list[str]:
    """That no drive is worth it, why, and where maps are not complete. left: the branches that
    nobody drove; about: the only site that drives were asked for."""
    why = (
        f"no drive is proposed: {_none_open(about)}, and none by a branch that "
        "nobody drove is likely to show that two sites are one place"
    )
    if len(result.components) == 1:
        alone = "site" if result.components[0].is_site else "run"
        why = f"there is one {alone}: nothing is left to join"
    why = _not_to_settle(result, place, about) or why
    ways: dict[str, dict[int, None]] = {}
    for branch in left:
        ways.setdefault(branch.site, {})[branch.junction] = None
    if not ways:
        return [why, "every branch was driven"]
    out = [why, "branches that nobody drove, which would complete a map, are at:"]
    for name, own in sorted(ways.items()):
        out.append(f"  {name}: {counted(len(own), 'junction')}: {', '.join(map(str, own))}")
    return out


def _none_open(about: Component | None) -> str:
    """That no pair is open, or none of those of a site."""
    return "no pair is open" if about is None else f"no open pair concerns {about.name}"


def _not_to_settle(result: MergeResult, place: Workspace, about: Component | None) -> str:
    """That no drive settles the pairs that are open, those of a site if there is one, and what
    does; "" if none is."""
    runs = result.home if about is None else about.poses
    pairs = [v for v in result.verdicts if v.standing is Standing.AMBIGUOUS]
    open_ = sum(v.a in runs or v.b in runs for v in pairs)
    if not open_:
        return ""
    return (
        f"{counted(open_, 'pair of runs is', 'pairs of runs are')} open, but no drive is likely to "
        "settle any: what it would find looks alike elsewhere, or a lock keeps them apart; if you "
        f"know: {place.call('lock', 'A', 'B', '--same')}, --never or --clear"
    )


def _plan(
    path: Path,
    found: Sequence[Drive],
    left: Sequence[Undriven],
    result: MergeResult,
    shown: Collection[str],
    place: Workspace,
    theme: str,
) -> str | bytes:
    """The contents of a file of the plan. A picture without drives shows the branches that nobody
    drove."""
    suffix = path.suffix.lower()
    if suffix in PLANS:
        return drives_csv(found) if suffix == PLANS[0] else drives_geojson(found, left)
    begin = {d.component for d in found}
    sites = [c for c in result.components if (c.id in begin if found else c.name in shown)]
    canvas = merge_picture(place, result, sites, theme, drives=found)
    return canvas.as_bytes(picture_form(path))
