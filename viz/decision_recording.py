"""The recording of why two runs were merged, or not: placements, evidence, threshold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from ..merge.decision import Decision
from ..merge.decision_text import headline, lines
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from . import palette
from .drawing import SHEET_MARGIN, bounds, pen_m
from .pages import bulleted
from .placements import PLACEMENTS, VIEWS, Mark, decision_picture
from .recording import (
    UP,
    Recording,
    blueprint,
    map_view,
    markdown,
    screen,
    write_cards,
    write_recording,
)
from .sheet import corners_of

MOST_LINKS = 1000
"""Links on the page of all evidence."""


def write_decision_recording(path: Path, a: TopoMap, b: TopoMap, decision: Decision) -> None:
    """Write why two runs were merged or not, atomically: the placements with the matched junctions
    tied, the evidence term by term, the threshold.

    Raises OSError if the file cannot be written.
    """
    a, b = with_turning_points(a), with_turning_points(b)
    picture, pen = decision_picture(a, b, decision), pen_m([a, b])

    def fill(recording: Recording) -> rrb.Blueprint:
        for root in (PLACEMENTS, VIEWS):
            recording.static((root,), UP)
        write_cards(recording, PLACEMENTS, picture.cells, [(title,) for title in picture.titles])
        for mark in picture.marks:
            _mark(recording, mark, pen)
        recording.static(("decision",), screen(lines(decision)))
        recording.static(("evidence",), screen(lines(decision, MOST_LINKS)))
        recording.static(("legend",), markdown(_LEGEND))
        low, high = bounds([corners_of(picture.cells)], margin=SHEET_MARGIN)
        return _blueprint(
            map_view((PLACEMENTS, VIEWS), "Placements", low, high), headline(decision)
        )

    write_recording(path, f"{a.run} - {b.run}", fill)


def _mark(recording: Recording, mark: Mark, pen: float) -> None:
    """Write a mark; what is said of it is shown where it is pointed at."""
    xy, told = list(mark.xy), list(mark.told)
    look: dict[str, Any] = {"colors": palette.rgb(palette.DARK[mark.ink])}
    known = {"told": told} if told and mark.form != "number" else {}
    if mark.form == "line":
        look["radii"] = 0.4 * pen * np.asarray(mark.pens)
        recording.lines(mark.name, xy, mark.order, known, **look)
        return
    cell_m = 0.5 * float(np.max(mark.pens))
    radii = {"ring": 1.8 * pen, "dot": 1.2 * pen, "cell": cell_m, "number": 0.0}
    look |= {"labels": told, "show_labels": True} if mark.form == "number" else {}
    recording.dots(mark.name, xy, mark.order, known, radii=radii[mark.form], **look)


_LEGEND = "# How to read it\n\n" + bulleted(
    [
        "**Placement**: the second run (**orange**) laid over the first (**blue**). White: matched "
        "junctions; the line between them shows how far apart they lie.",
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


def _blueprint(view: rrb.Spatial2DView, name: str) -> rrb.Blueprint:
    return blueprint(
        rrb.Horizontal(
            view,
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
