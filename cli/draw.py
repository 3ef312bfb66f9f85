"""`topobatch draw`: a map, a merge or a decision as a picture on paper."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from ..merge.result import Component
from ..topology.errors import UsageError
from ..topology.topomap import TopoMap
from .options import RUNS, Here, ThemeOption, verb
from .output import checked_output, say, write_files
from .workspace import Workspace

if TYPE_CHECKING:  # which loads matplotlib
    from ..viz.canvas import Canvas
    from ..viz.palette import Theme


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
    from ..viz.palette import THEMES

    form = picture_form(out)
    quiet_fonts()
    canvas = _drawn(place, what, THEMES[theme])
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


def _drawn(place: Workspace, what: str, theme: Theme) -> Canvas:
    """The drawing of a run, a merge or a pair."""
    from ..viz import draw as drawings

    found = place.named(what)
    if found.run is not None:
        return drawings.draw_map(place.read_map(found.run), theme)
    if found.pair is not None:
        from ..viz.draw_pair import draw_decision
        from .explain import decided

        return draw_decision(*decided(place, found.pair), theme)
    result = found.place.read_result()
    if found.site is None:
        return drawings.draw_merged(result, theme, maps=walled(place, result.components))
    (site,) = (c for c in result.components if c.site == found.site)
    return drawings.draw_merged(result, theme, sites=[site.id], maps=walled(place, [site]))


def walled(place: Workspace, components: Iterable[Component]) -> dict[str, TopoMap]:
    """The maps of the runs of components that can be read."""
    maps, _ = place.read_maps(run for c in components for run in c.poses)
    return maps
