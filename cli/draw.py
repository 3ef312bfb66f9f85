"""`topobatch draw`: a map, a merge or a decision as a picture on paper."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ..merge.result import Component, MergeResult
from ..topology.errors import UsageError
from .options import RUNS, Here, ThemeOption, verb
from .output import checked_output, say, write_files
from .workspace import Workspace

if TYPE_CHECKING:  # which loads matplotlib
    from ..viz.canvas import Canvas


@verb
def draw(
    what: Annotated[
        str,
        "RUN|SITE|merged|A:B",
        "A run or a site, for its map; merged, or the --output NAME of a merge; or two runs, for "
        "why they were merged or not.",
        RUNS,
    ],
    out: Annotated[Path, "OUT.svg|OUT.png", "The picture to write."],
    place: Here,
    theme: ThemeOption = "light",
) -> None:
    """Draw a map, the merged map, or the decision on a pair of runs.

    Needs no viewer and no display; the same map gives the same bytes. In the SVG of a run, pointing
    at a corridor or a junction tells its number, its length, its sigma; in that of a site, the
    number of a junction.

    Where a laser or a saved map showed walls, they lie below. A run's map: junctions coloured by
    their branches, corridors wider the more often they were driven. The merged map: every corridor
    a ribbon with a strand for each run that drove it. A site: the same, with the numbers of its
    junctions in merged.json. A pair: one map laid over the other with the matched junctions tied;
    of an ambiguous pair both placements side by side; beside them the views that speak most for a
    placement, and most against it.

    \b
      topobatch draw run1 run1.svg
      topobatch draw merged merged.png --theme dark
      topobatch site run1 north
      topobatch draw north north.svg
      topobatch draw run1:run2 why.svg
    """
    form = picture_form(out)
    canvas = _drawn(place, what, theme)
    write_files({out: canvas.as_bytes(form)})
    say(f"{out}")


def picture_form(out: Path) -> Literal["svg", "png"]:
    """The form of a picture by its file's name; UsageError if that cannot be written."""
    match checked_output(out).suffix.lower():
        case ".svg":
            return "svg"
        case ".png":
            return "png"
    raise UsageError(f"{out}: a picture's name ends in .svg or .png")


def quiet_fonts() -> None:
    """Silence matplotlib's log about its caches, for instance in a read-only home."""
    logging.getLogger("matplotlib").setLevel(logging.ERROR)


def _drawn(place: Workspace, what: str, theme: str) -> Canvas:
    """The drawing of a run, a merge or a pair."""
    from ..viz.palette import THEMES

    found = place.named(what)
    quiet_fonts()
    if found.run is not None:
        from ..viz.draw import draw_map

        return draw_map(place.read_map(found.run), THEMES[theme])
    if found.pair is not None:
        from ..viz.draw_pair import draw_decision
        from .explain import decided

        return draw_decision(*decided(place, found.pair), THEMES[theme])
    result = found.place.read_result()
    site = [c for c in result.components if c.site == found.site] if found.site else None
    return merge_picture(place, result, site, theme)


def merge_picture(
    place: Workspace,
    result: MergeResult,
    sites: Sequence[Component] | None,
    theme: str,
    **shown: Any,
) -> Canvas:
    """The drawing of some sites of a merge, or of all of it, with the walls of the runs whose maps
    can be read; shown: drives or changes, as of `draw_merged`."""
    from ..viz.draw import draw_merged
    from ..viz.palette import THEMES

    quiet_fonts()
    maps, _ = place.read_maps(run for c in sites or result.components for run in c.poses)
    ids = None if sites is None else [c.id for c in sites]
    return draw_merged(result, THEMES[theme], sites=ids, maps=maps, **shown)
