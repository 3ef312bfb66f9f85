"""The recording of why two runs were merged, or not: placements, evidence, threshold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from ..merge.decision import Decision
from ..merge.decision_text import digits_of, headline, lines, short
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT
from ..topology.se2 import turned
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.views import CELL_M
from . import palette
from .drawing import pen_m
from .map_sheet import (
    LaidOver,
    sheet_view,
    write_cards,
    write_laid_over,
    write_words,
)
from .map_summary import bulleted
from .placements import CORNERS, WIDTHS, Mark, Overlay, marks, overlays, placements
from .recording import (
    UP,
    PathParts,
    Recording,
    blueprint,
    markdown,
    screen,
    write_recording,
)
from .sheet import Cell, arrange, upright_rad

PLACEMENTS, VIEWS = "placements", "views"

VIEW_MARGIN_M = 1.0
"""Margin around views that are laid over each other."""

TOLD = {SILENT: "silent", AGREES: "agrees", CONTRADICTS: "contradicts"}
"""Names of what walls of one view tell of the other."""

MOST_LINKS = 1000
"""Links on the page of all evidence."""

FOOT = 0.06
"""Height of the runs' names above the foot of a cell, over its smaller side."""


def write_decision_recording(path: Path, a: TopoMap, b: TopoMap, decision: Decision) -> None:
    """Write why two runs were merged or not, atomically: the placements with the matched junctions
    tied, the evidence term by term, the threshold.

    Raises OSError if the file cannot be written.
    """

    def fill(recording: Recording) -> rrb.Blueprint:
        cells = _pictures(recording, with_turning_points(a), with_turning_points(b), decision)
        seen = _views(recording, overlays(decision), upright_rad(a.paths))
        recording.static(("decision",), screen(lines(decision)))
        recording.static(("evidence",), screen(lines(decision, MOST_LINKS)))
        recording.static(("legend",), markdown(_LEGEND))
        return _blueprint(cells, seen, headline(decision))

    write_recording(path, f"{a.run} - {b.run}", fill)


def _pictures(recording: Recording, a: TopoMap, b: TopoMap, decision: Decision) -> list[Cell]:
    drawn = placements(a, b, decision)
    laid = [LaidOver((p.name,), (p.title,), (a, b), p.T_a_b) for p in drawn]
    cells = write_laid_over(recording, PLACEMENTS, laid)
    pen = pen_m([a, b])
    for picture, cell in zip(drawn, cells, strict=True):
        for mark in marks(picture, a, b, digits_of(decision)):
            _mark(recording, (PLACEMENTS, picture.name), mark, pen)
        _names(recording, picture.name, cell, (a.run, b.run))
    return cells


def _mark(recording: Recording, here: PathParts, mark: Mark, pen: float) -> None:
    """Write a mark of a placement below an entity."""
    path = (*here, *mark.name)
    colours = [palette.rgb(palette.DARK[ink]) for ink in mark.ink]
    if mark.form == "number":
        write_words(recording, path, mark.xy, list(mark.told), colours=colours, order=mark.order)
        return
    look: dict[str, Any] = {"colors": colours, "draw_order": mark.order}
    shape: Any = rr.Points2D(mark.xy, radii=1.8 * pen, **look)
    if mark.form == "line":
        shape = rr.LineStrips2D(list(mark.xy), radii=0.4 * pen * mark.pens, **look)
    recording.static(path, shape, *([rr.AnyValues(**mark.info)] if mark.info else []))


def _views(recording: Recording, shown: list[Overlay], turn_rad: float) -> list[Cell]:
    """The views that speak most for a placement and against it, one laid over the other."""
    square = turned(CORNERS, -turn_rad)
    cells = arrange([square] * len(shown), [turn_rad] * len(shown), VIEW_MARGIN_M)
    if not shown:
        return cells
    recording.static((VIEWS,), UP)
    write_cards(recording, VIEWS, cells, [(overlay.title,) for overlay in shown])
    for overlay, cell in zip(shown, cells, strict=True):
        middle = (cell.low + cell.high) / 2
        for run, kind, xy in overlay.layers(turn_rad):
            colour = palette.of_rank(run)
            colour = {SILENT: palette.dimmed(colour), AGREES: colour}.get(kind, palette.REFUSED)
            dots = rr.Points2D(
                middle + xy,
                radii=0.5 * CELL_M * WIDTHS[run],
                colors=colour,
                draw_order=palette.Order.WALL,
            )
            path = (VIEWS, overlay.name, ("a", "b")[run], TOLD[kind])
            recording.static(path, dots)
    return cells


def _names(recording: Recording, name: str, cell: Cell, runs: tuple[str, str]) -> None:
    """The runs' names in their colours, at the foot of a cell."""
    width, height = cell.high - cell.low
    low = cell.low[1] + FOOT * min(width, height)
    places = [(cell.low[0] + share * width, low) for share in (0.3, 0.7)]
    write_words(
        recording,
        (PLACEMENTS, "names", name),
        places,
        [short(run) for run in runs],
        colours=[palette.of_rank(0), palette.of_rank(1)],
    )


_LEGEND = "# How to read it\n\n" + bulleted(
    [
        "**Placement**: the second run laid over the first. White: matched junctions; the line "
        "between them shows how far apart they lie.",
        "**Green** lines are links: a corridor that both runs have, or how two matched junctions "
        "near each other lie. The wider, the more bits. **Red**: what speaks against it.",
        "**Views**: what lasers saw at one place, the walls of the second run, smaller, laid over "
        "those of the first: where they speak most for the placement, and most against it. "
        "**Bright** walls agree, **red** ones stand in what the other saw to be free, **dim** ones "
        "say nothing.",
        "**Tied**: the same placement with the second run drawn below the first.",
        "Each **bit** doubles the odds that so much agrees because it is one place. The parts add "
        "up to the evidence; it is compared with what is needed.",
        "Point at anything for its numbers.",
    ]
)


def _blueprint(cells: list[Cell], seen: list[Cell], name: str) -> rrb.Blueprint:
    pictures = [sheet_view(PLACEMENTS, "Placements", cells)]
    pictures += [sheet_view(VIEWS, "Views", seen)] if seen else []
    return blueprint(
        rrb.Horizontal(
            rrb.Tabs(*pictures, active_tab=0),
            rrb.Tabs(
                rrb.TextDocumentView(origin="/decision", name="Decision"),
                rrb.TextDocumentView(origin="/evidence", name="All evidence"),
                rrb.TextDocumentView(origin="/legend", name="How to read it"),
                active_tab=0,
                name="Why",
            ),
            column_shares=[3, 2],
            name=name,
        ),
        rrb.TimePanel(state="hidden"),
    )
