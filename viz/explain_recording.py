"""Recording of a structural match between two maps: its hypotheses and their clusters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from ..merge.paper.explain import Explanation, lines
from ..topology.arrays import FloatArray
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import counted
from . import palette
from .map_sheet import LaidOver, sheet_view, write_laid_over
from .recording import HAIR, Recording, blueprint, screen, write_recording
from .sheet import Cell, outline

TABLE, SPACE, PLACEMENTS = "table", "transforms", "placements"

TOLD_APART = 9
"""Number of clusters with a colour of their own."""

OTHER, DROPPED = TOLD_APART + 1, TOLD_APART + 2
"""Classes of the table after those of the clusters."""

MOST_PLACEMENTS = 9
MOST_ROWS = 40
"""Limits: placements drawn, and rows of tables."""

HEIGHT = 0.6
"""Height of a full turn in the plot of transforms, over the extent of x and y."""


def write_explain_recording(path: Path, a: TopoMap, b: TopoMap, e: Explanation) -> None:
    """Write a structural match's recording, atomically: the table of vertex pairs, the clusters in
    the space of transforms, and b over a as the best clusters place it.

    Raises OSError if the file cannot be written.
    """

    def fill(recording: Recording) -> rrb.Blueprint:
        _table(recording, a, b, e)
        _transform_space(recording, e)
        cells = _placements(recording, with_turning_points(a), with_turning_points(b), e)
        recording.static(("summary",), screen(lines(e, MOST_ROWS)))
        views = [_table_view(a, b)]
        if len(e.hypotheses.size):
            views = [sheet_view(PLACEMENTS, "Placements", cells), _space_view(e), *views]
        return _blueprint(views)

    write_recording(path, f"{a.run} - {b.run}", fill)


def _colour(rank: int) -> palette.Colour:
    return palette.of_rank(rank) if 0 <= rank < TOLD_APART else palette.DIM


def _title(e: Explanation, k: int) -> str:
    return f"{k + 1}: {counted(int(e.clusters.vertices[k]), 'pair')}"


def pair_classes(shape: tuple[int, int], e: Explanation) -> NDArray[np.uint8]:
    """(n_a, n_b) class of each vertex pair: 0 incompatible; 1 … TOLD_APART the best cluster that
    holds it; OTHER another cluster or none; DROPPED compatible but in no hypothesis."""
    h = e.hypotheses
    cells = np.zeros(shape, np.uint8)
    cells[e.candidate_a, e.candidate_b] = DROPPED
    cluster = e.clusters.of[h.of]
    rank = np.where((cluster >= 0) & (cluster < TOLD_APART), cluster, TOLD_APART)
    # Written from the worst cluster to the best: a pair keeps its best.
    order = np.argsort(-rank, kind="stable")
    cells[h.vertex_a[order], h.vertex_b[order]] = rank[order] + 1
    return cells


def _table(recording: Recording, a: TopoMap, b: TopoMap, e: Explanation) -> None:
    if len(a) == 0 or len(b) == 0:
        return
    classes = [(0, "incompatible", palette.DIAGONAL)]
    classes += [(k + 1, f"cluster {k + 1}", _colour(k)) for k in range(TOLD_APART)]
    classes.append((OTHER, "another cluster", palette.DIM))
    classes.append((DROPPED, "compatible, no hypothesis survived", palette.UNRELATED))
    recording.static((TABLE,), rr.AnnotationContext(classes))
    # Sorted by number of branches: compatible are vertices with the same number, or nearly.
    rows = np.argsort(e.degree_a, kind="stable")
    columns = np.argsort(e.degree_b, kind="stable")
    cells = pair_classes((len(a), len(b)), e)[np.ix_(rows, columns)]
    recording.static((TABLE, "pairs"), rr.SegmentationImage(cells, opacity=1.0))


def _space(e: Explanation) -> tuple[FloatArray, FloatArray, float]:
    """Low and high corner (2,) of all translations [m], and the height of a radian in the plot
    [m/rad]."""
    shift = e.hypotheses.transform[:, :2]
    low, high = shift.min(axis=0), shift.max(axis=0)
    return low, high, HEIGHT * max(float((high - low).max()), 1.0) / (2 * np.pi)


def _transform_space(recording: Recording, e: Explanation) -> None:
    """Write hypotheses and clusters as points (x, y, rotation), with the rotation upwards."""
    h, c = e.hypotheses, e.clusters
    if len(h.size) == 0:
        return
    low, high, rise = _space(e)

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
    _turn_levels(recording, low, high, rise)


def _turn_levels(recording: Recording, low: FloatArray, high: FloatArray, rise: float) -> None:
    """Write a frame at every quarter turn as the scale of the rotation axis."""
    spare = 0.05 * max(float((high - low).max()), 1.0)
    corners = outline(low - spare, high + spare)
    quarters = np.arange(-2, 3)
    frames = [np.column_stack([corners, np.full(5, rise * q * np.pi / 2)]) for q in quarters]
    lines = rr.LineStrips3D(frames, radii=HAIR, colors=palette.CARD)
    recording.static((SPACE, "quarter turns"), lines)
    names = rr.Points3D(
        np.array([frame[1] for frame in frames]),
        radii=0.0,
        colors=palette.TITLE,
        labels=[f"{90 * q}°" for q in quarters],
        show_labels=True,
    )
    recording.static((SPACE, "quarter turns", "names"), names)


def _placements(recording: Recording, a: TopoMap, b: TopoMap, e: Explanation) -> list[Cell]:
    """Write b over a as each of the best clusters places it."""
    h, c = e.hypotheses, e.clusters
    laid = []
    for k in range(min(len(c.vertices), MOST_PLACEMENTS)):
        matched = np.unique(h.vertex_a[c.of[h.of] == k])
        path, title = (f"cluster {k + 1}",), (_title(e, k),)
        laid.append(LaidOver(path, title, (a, b), c.transform[k], k, matched))
    return write_laid_over(recording, PLACEMENTS, laid)


def _space_view(e: Explanation) -> rrb.View:
    """The view of the transforms, with the camera placed so that all of them are visible."""
    low, high, _ = _space(e)
    middle, extent = (low + high) / 2, max(float((high - low).max()), 1.0)
    return rrb.Spatial3DView(
        origin=f"/{SPACE}",
        name="Transform space",
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=(middle[0] - 0.7 * extent, middle[1] - 1.7 * extent, 0.8 * extent),
            look_target=(middle[0], middle[1], 0.0),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )


def _table_view(a: TopoMap, b: TopoMap) -> rrb.View:
    spare = 0.03 * max(len(a), len(b), 1)
    return rrb.Spatial2DView(
        origin=f"/{TABLE}",
        name=f"Vertices of {a.run} (down) and {b.run} (across)",
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-spare, len(b) + spare], y_range=[-spare, len(a) + spare]
        ),
    )


def _blueprint(views: list[rrb.View]) -> rrb.Blueprint:
    return blueprint(
        rrb.Horizontal(
            rrb.Tabs(*views, active_tab=0, name="Maps"),
            rrb.TextDocumentView(origin="/summary", name="Clusters and hypotheses"),
            column_shares=[2, 1],
            name="Match of two maps",
        ),
        rrb.TimePanel(state="hidden"),
    )
