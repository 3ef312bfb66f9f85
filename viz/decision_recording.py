"""The recording of why two runs were merged, or not: placements, evidence, threshold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..merge.decision import AGAINST, LINKS, Decision, Placement
from ..merge.decision_text import headline, lines, short
from ..topology.arrays import FloatArray
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT
from ..topology.se2 import apply, turned
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.views import CELL_M
from . import palette
from .drawing import MOST_NUMBERED, extent, pen_m
from .map_sheet import (
    LaidOver,
    sheet_view,
    write_cards,
    write_laid_over,
    write_own_maps,
    write_rings,
    write_words,
)
from .map_summary import bulleted
from .placements import CORNERS, WIDTHS, Overlay, contradiction_spots, overlays, placements
from .recording import (
    UP,
    PathParts,
    Recording,
    blueprint,
    markdown,
    placed,
    screen,
    write_recording,
)
from .sheet import Cell, arrange, sheet_margin_m, upright_rad

Drawn = tuple[FloatArray, FloatArray]
"""Where the junctions of a and of b are drawn, in a's frame."""

PLACEMENTS, VIEWS = "placements", "views"

VIEW_MARGIN_M = 1.0
"""Margin around views that are laid over each other."""

TOLD = {SILENT: "silent", AGREES: "agrees", CONTRADICTS: "contradicts"}
"""Names of what walls of one view tell of the other."""

MOST_LINKS = 1000
"""Links on the page of all evidence."""

FOOT = 0.06
"""Height of the runs' names above the foot of a cell, over its smaller side."""

FULL_BITS = 6.0
"""A link of this many bits is drawn widest."""


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
    if not drawn:  # nothing to lay over each other: the two maps as they are
        return _side_by_side(recording, a, b)
    laid = []
    for number, p in enumerate(drawn):
        of_b, terms = apply(p.T_a_b, b.xy), p.placement.of(*AGAINST) if p.placement else ()
        against = ((f"{t.bits:+.2f} bits: {t.text}", (t.a, t.b)) for t in terms if t.a or t.b)
        spots = contradiction_spots(against, a.xy, of_b)
        none = np.zeros(0, np.int64)
        laid.append(LaidOver((p.name,), (p.title,), (a, b), p.T_a_b, number, none, spots))
    cells = write_laid_over(recording, PLACEMENTS, laid)
    pen = pen_m([a, b])
    for picture, cell in zip(drawn, cells, strict=True):
        here = (PLACEMENTS, picture.name)
        if picture.placement is not None:
            xy = (a.xy, apply(picture.T_a_b, b.xy))
            _ties(recording, here, picture.placement, xy, pen=pen, apart=picture.tied)
            _links(recording, here, picture.placement, xy, pen=pen, both=picture.tied)
        _names(recording, picture.name, cell, (a.run, b.run))
    return cells


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


def _side_by_side(recording: Recording, a: TopoMap, b: TopoMap) -> list[Cell]:
    maps = [a, b]
    points = [extent(m) for m in maps]
    cells = arrange(points, [upright_rad(m.paths) for m in maps], sheet_margin_m(points))
    recording.static((PLACEMENTS,), UP)
    write_cards(recording, PLACEMENTS, cells, [(short(m.run),) for m in maps])
    for k, (m, cell) in enumerate(zip(maps, cells, strict=True)):
        here = (PLACEMENTS, "maps", m.run)
        recording.static(here, placed(cell.T_sheet_map))
        write_own_maps(recording, [here], [m], [palette.of_rank(k)], pen_m(maps))
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


def _ties(
    recording: Recording,
    here: PathParts,
    placement: Placement,
    xy: Drawn,
    *,
    pen: float,
    apart: bool,
) -> None:
    """Matched junctions with their numbers, of b only where it is drawn `apart`, and a line from
    each to its partner."""
    pairs = placement.alignment.matched
    if not len(pairs):
        return
    one, two = xy[0][pairs[:, 0]], xy[1][pairs[:, 1]]
    lines = rr.LineStrips2D(
        list(np.stack([one, two], axis=1)),
        radii=0.25 * pen,
        colors=palette.WHITE,
        draw_order=palette.Order.TIE,
    )
    info = rr.AnyValues(junction_of_a=pairs[:, 0], junction_of_b=pairs[:, 1])
    recording.static((*here, "ties"), lines, info)
    for k, (name, at) in enumerate((("a", one), ("b", two))):
        write_rings(recording, (*here, "matched", name), at, 1.8 * pen, palette.Order.RING)
        if (apart or k == 0) and len(pairs) <= MOST_NUMBERED:
            path, numbers = (*here, "numbers", name), [str(v) for v in pairs[:, k].tolist()]
            write_words(recording, path, at, numbers, colours=palette.of_rank(k))


def _links(
    recording: Recording,
    here: PathParts,
    placement: Placement,
    xy: Drawn,
    *,
    pen: float,
    both: bool,
) -> None:
    """Every link between two junctions of a; `both`: also between those of b."""
    links = placement.of(*LINKS)
    for ends, at, name in ((0, xy[0], "a"), (1, xy[1], "b")):
        shown = [t for t in links if len((t.a, t.b)[ends]) == 2]
        if not shown or (ends and not both):
            continue
        bits = np.array([t.bits for t in shown])
        lines = rr.LineStrips2D(
            at[np.array([(t.a, t.b)[ends] for t in shown])],
            radii=pen * (0.9 + 1.3 * np.minimum(np.abs(bits) / FULL_BITS, 1.0)),
            colors=[palette.MERGED if t.bits >= 0 else palette.REFUSED for t in shown],
            draw_order=palette.Order.EVIDENCE,
        )
        told = rr.AnyValues(bits=[t.bits for t in shown], what=[t.text for t in shown])
        recording.static((*here, "links", name), lines, told)


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
