"""Maps on a sheet of cells: frames, titles, a run's own map, one map over another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..merge.decision_text import short
from ..topology.topomap import TopoMap
from . import palette
from .drawing import SHEET_MARGIN, bounds
from .placements import Spot
from .recording import HAIR, PathParts, Recording, map_view, strips
from .sheet import ASPECT, Cell, corners_of, outline

TITLE_LETTERS, SHORTEST_TITLE = 150, 5
"""Letters across a view of typical width; titles with room for fewer than SHORTEST_TITLE are left
out."""


def sheet_view(root: str, name: str, cells: Sequence[Cell]) -> rrb.Spatial2DView:
    """A view of everything below `/root`, which is laid out in these cells."""
    return map_view([root], name, *bounds([corners_of(cells)], margin=SHEET_MARGIN))


def write_words(
    recording: Recording,
    path: PathParts,
    places: Any,
    words: list[str],
    *,
    colours: Any = palette.TITLE,
    order: palette.Order = palette.Order.WORDS,
) -> None:
    """Write a label below each of the places (n, 2)."""
    shown = rr.Points2D(
        places, radii=0.0, colors=colours, labels=words, show_labels=True, draw_order=order
    )
    recording.static(path, shown)


def write_contradictions(
    recording: Recording, path: PathParts, spots: Sequence[Spot], pen: float
) -> None:
    """Write a red dot for each contradiction; its text is shown on selection."""
    if spots:
        dots = rr.Points2D(
            [spot.xy for spot in spots],
            radii=2.0 * pen,
            colors=palette.REFUSED,
            draw_order=palette.Order.CONTRADICTION,
        )
        told = rr.AnyValues(contradiction=[spot.told for spot in spots])
        recording.static(path, dots, told)


def write_cards(
    recording: Recording, root: str, cells: list[Cell], titles: Sequence[Sequence[str]]
) -> None:
    """Write a frame for each of several cells, and its title: the first that fits of the given
    forms, longest first. `titles` may be empty."""
    if len(cells) > 1:
        frames = rr.LineStrips2D(
            [outline(cell.low, cell.high) for cell in cells],
            radii=HAIR,
            colors=palette.CARD,
            draw_order=palette.Order.CARD,
        )
        recording.static((root, "frames"), frames)
    width, height = np.ptp(corners_of(cells), axis=0) if cells else np.zeros(2)
    seen_m = max(float(width), ASPECT * float(height))
    shown = [(k, _fitting(forms, cells[k], seen_m)) for k, forms in enumerate(titles)]
    shown = [(k, title) for k, title in shown if title]
    if shown:
        tops = [((cells[k].low[0] + cells[k].high[0]) / 2, cells[k].high[1]) for k, _ in shown]
        write_words(recording, (root, "titles"), tops, [title for _, title in shown])


def _fitting(titles: Sequence[str], cell: Cell, seen_m: float) -> str:
    """The first title that fits the cell, where the sheet is `seen_m` wide in a view of typical
    width; else the last one, cut, or "" if the room is less than SHORTEST_TITLE."""
    share = (cell.high[0] - cell.low[0]) / seen_m
    room = int(share * TITLE_LETTERS)
    fitting = next((title for title in titles if len(title) <= room), None)
    if fitting is not None:
        return fitting
    return short(titles[-1], room) if room >= SHORTEST_TITLE else ""


def corridors_told(m: TopoMap) -> rr.AnyValues:
    """The attributes of the corridors of a map."""
    return rr.AnyValues(
        corridor=np.arange(len(m.source)),
        between=[f"{u} - {v}" for u, v in zip(m.source.tolist(), m.target.tolist(), strict=True)],
        length_m=m.length,
        length_sigma_m=m.length_sigma,
        traversals=m.traversals,
    )


def write_own_map(
    recording: Recording, path: PathParts, m: TopoMap, colour: palette.Colour, pen: float
) -> None:
    """Write a run's own map below its entity path, in its own frame and in one colour."""
    if len(m.source):
        lines = rr.LineStrips2D.from_fields(
            strips=strips(m.paths),
            radii=0.4 * pen,
            colors=colour,
            draw_order=palette.Order.CORRIDOR,
        )
        recording.static((*path, "corridors"), lines, corridors_told(m))
    if len(m):
        points = rr.Points2D(
            m.xy,
            radii=1.2 * pen,
            colors=colour,
            labels=[*map(str, range(len(m)))],
            show_labels=False,
            draw_order=palette.Order.JUNCTION,
        )
        info = rr.AnyValues(vertex=np.arange(len(m)), kind=list(m.kind), branches=m.degree)
        recording.static((*path, "junctions"), points, info)
