"""`topobatch changes`: what is there in some runs and not in others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ..merge.change import Change, change_to_document, numbered
from ..merge.changes import changes as changes_of
from ..topology.wording import counted, listed
from ..viz.parts import in_order
from .draw import merge_picture, picture_form
from .options import ComponentOption, HereWithMerge, JsonOption, ThemeOption, verb
from .output import say, say_folded, say_json, write_files


@verb
def changes(
    site: Annotated[str | None, "SITE", "Only this site (topobatch list)."] = None,
    component: ComponentOption = None,
    everything: Annotated[bool, "--all", "Also differences that may be due to chance."] = False,
    output: Annotated[
        list[Path] | None,
        "--output -o FILE",
        "Also draw them there (.svg, .png); may be given twice.",
    ] = None,
    theme: ThemeOption = "light",
    *,
    place: HereWithMerge,
    as_json: JsonOption = False,
) -> None:
    """Tell what changed between the runs that were merged.

    Corridors and junctions that some runs found and others did not, although these came by: gone,
    new, or there at times. Saved maps have no times and are not compared. Each with the times
    between which it changed, the runs, and the evidence in bits: n bits mean odds of 2^n to 1 that
    the others did not just miss it.

    \b
      topobatch changes
      topobatch site run1 north
      topobatch changes north -o changes.svg
      topobatch changes --all --json
    """
    forms = {path: picture_form(path) for path in output or ()}
    result = place.read_result()
    chosen = place.component(result, site, component)
    several = [c for c in in_order(result) if len(c.poses) > 1 and chosen in (None, c.id)]
    found: list[Change] = []
    saved: list[str] = []
    compared = []
    for one in several:
        maps = place.maps_as_merged(result, one.id, sorted(one.poses))
        with place.document_at_fault():
            found += changes_of(result, one.id, maps)
        not_driven = [run for run, m in maps.items() if not m.is_driven]
        if len(maps) > len(not_driven) + 1:
            compared.append(one)
        saved += not_driven
    with_numbers = numbered(c for c in found if everything or c.sure)
    shown = [change for _, change in with_numbers]
    if forms:
        changed = {c.component for c in shown}
        drawn = [c for c in several if c.id in changed or not changed] or result.components
        picture = merge_picture(place, result, drawn, theme, changes=shown)
        write_files({path: picture.as_bytes(form) for path, form in forms.items()})
    if as_json:
        sites = {c.id: c.site or None for c in result.components}
        say_json([change_to_document(c) | {"site": sites[c.component]} for c in shown])
        return
    for one in compared:
        own = [(k, change) for k, change in with_numbers if change.component == one.id]
        if not own:
            say(f"{one.name}: nothing changed")
        for k, change in own:
            what, *more_lines = change.words(one.name)
            say_folded(f"{k}. {what}", indent="   ")
            for line in more_lines:
                say_folded(f"  {line}", indent="    ")
    unsure = sum(not c.sure for c in found)
    more = f", and {counted(unsure, 'difference')} that may be due to chance" if unsure else ""
    hint = " (--all shows them)" if unsure and not everything else ""
    say_folded(
        f"{counted(len(found) - unsure, 'change')}{more}{hint}"
        if compared
        else "no two recorded runs were merged: nothing to compare"
    )
    if saved:
        say_folded(f"saved maps tell no times and are left out: {listed(saved, 3)}")
    if forms or any(c.sure for c in shown):
        named = () if site is None else (site,)
        draw = place.call("changes", *named, *place.of_merge, "-o", "changes.svg")
        say(f"times are UTC; on the map: {', '.join(map(str, forms)) or draw}")
