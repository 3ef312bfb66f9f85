"""Recording of a structural match between two maps: its hypotheses and their clusters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..merge.paper.explain import Explanation, lines
from ..topology.arrays import FloatArray
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import counted
from . import palette
from .map_sheet import LaidOver, sheet_view, write_laid_over
from .recording import Recording, blueprint, screen, write_recording
from .sheet import Cell

SPACE, PLACEMENTS = "transforms", "placements"

TOLD_APART = 9
"""Number of clusters with a colour of their own."""

MOST_PLACEMENTS = 9
MOST_ROWS = 40
"""Limits: placements drawn, and rows of tables."""

HEIGHT = 0.6
"""Height of a full turn in the plot of transforms, over the extent of x and y."""


def write_explain_recording(path: Path, a: TopoMap, b: TopoMap, e: Explanation) -> None:
    """Write a structural match's recording, atomically: the clusters in the space of transforms,
    and b over a as the best clusters place it. The table of vertex pairs is among the texts.

    Raises OSError if the file cannot be written.
    """

    def fill(recording: Recording) -> rrb.Blueprint:
        _transform_space(recording, e)
        cells = _placements(recording, with_turning_points(a), with_turning_points(b), e)
        recording.static(("summary",), screen(lines(e, MOST_ROWS)))
        page = rrb.TextDocumentView(origin="/summary", name="Clusters and hypotheses")
        if not len(e.hypotheses.size):
            return blueprint(rrb.Tabs(page), rrb.TimePanel(state="hidden"))
        views = rrb.Tabs(
            sheet_view(PLACEMENTS, "Placements", cells),
            rrb.Spatial3DView(
                origin=f"/{SPACE}",
                name="Transform space",
                background=palette.BACKGROUND,
                line_grid=False,
            ),
            active_tab=0,
            name="Maps",
        )
        root = rrb.Horizontal(views, page, column_shares=[2, 1], name="Match of two maps")
        return blueprint(root, rrb.TimePanel(state="hidden"))

    write_recording(path, f"{a.run} - {b.run}", fill)


def _colour(rank: int) -> palette.Colour:
    return palette.of_rank(rank) if 0 <= rank < TOLD_APART else palette.DIM


def _title(e: Explanation, k: int) -> str:
    return f"{k + 1}: {counted(int(e.clusters.vertices[k]), 'pair')}"


def _transform_space(recording: Recording, e: Explanation) -> None:
    """Write hypotheses and clusters as points (x, y, rotation), with the rotation upwards."""
    h, c = e.hypotheses, e.clusters
    if len(h.size) == 0:
        return
    extent = float(np.ptp(h.transform[:, :2], axis=0).max())
    rise = HEIGHT * max(extent, 1.0) / (2 * np.pi)

    def drawn(transform: FloatArray) -> FloatArray:
        return np.asarray(transform) * [1.0, 1.0, rise]

    recording.static(
        (SPACE, "hypotheses"),
        rr.Points3D(
            drawn(h.transform),
            radii=-2.0 - 1.5 * np.sqrt(h.size),  # negative: in points of the screen
            colors=[_colour(int(k)) for k in c.of],
        ),
        rr.AnyValues(
            hypothesis=np.arange(len(h.size)) + 1,
            cluster=c.of + 1,  # 0: none
            vertices=h.size,
            corridors=h.corridors,
            error_m2=h.error,
            turn_deg=np.degrees(h.transform[:, 2]),
        ),
    )
    shown = min(len(c.vertices), TOLD_APART)
    labels = rr.Points3D(
        drawn(c.transform[:shown]),
        radii=rr.Radius.ui_points(1.0),
        colors=[_colour(k) for k in range(shown)],
        labels=[_title(e, k) for k in range(shown)],
        show_labels=True,
    )
    recording.static((SPACE, "clusters"), labels)


def _placements(recording: Recording, a: TopoMap, b: TopoMap, e: Explanation) -> list[Cell]:
    """Write b over a as each of the best clusters places it."""
    h, c = e.hypotheses, e.clusters
    laid = []
    for k in range(min(len(c.vertices), MOST_PLACEMENTS)):
        matched = np.unique(h.vertex_a[c.of[h.of] == k])
        path, title = (f"cluster {k + 1}",), (_title(e, k),)
        laid.append(LaidOver(path, title, (a, b), c.transform[k], matched))
    return write_laid_over(recording, PLACEMENTS, laid)
