"""Recording of a structural match between two maps: its hypotheses and their clusters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from ..topology.arrays import FloatArray, IntArray
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import counted
from . import palette
from .drawing import extent, pen_m
from .map_sheet import sheet_view, write_cards, write_laid_over, write_rings
from .map_summary import plain, several
from .recording import HAIR, UP, Recording, blueprint, markdown, write_recording
from .sheet import Cell, arrange, outline, sheet_margin_m, upright_rad

if TYPE_CHECKING:
    from ..merge.paper.explain import Explanation


TABLE, SPACE, PLACEMENTS = "table", "transforms", "placements"

TOLD_APART = 9
"""Number of clusters with a colour of their own."""

OTHER, DROPPED = TOLD_APART + 1, TOLD_APART + 2
"""Classes of the table after those of the clusters."""

MOST_PLACEMENTS = 9
MOST_ROWS = 40
"""Limits: placements drawn, and rows of the tables of clusters and hypotheses."""

NUMBER_GAP = 0.035
"""Distance of the vertices' numbers from the table, over the table's size."""

MOST_NUMBERED = 45
"""Up to this many vertices the table's rows and columns are numbered."""

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
        recording.static(("summary",), markdown(_told(a, b, e)))
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
    if max(len(a), len(b)) <= MOST_NUMBERED:
        _numbers(recording, rows, columns)


def _numbers(recording: Recording, rows: IntArray, columns: IntArray) -> None:
    """Write the vertices' numbers left of and above the table, in cells."""
    count = max(len(rows), len(columns))
    gap = NUMBER_GAP * count
    rise = count / 128  # the viewer writes below a point
    left = np.stack([np.full(len(rows), -gap), np.arange(len(rows)) + 0.5 - rise], axis=-1)
    above = np.stack([np.arange(len(columns)) + 0.5, np.full(len(columns), -gap)], axis=-1)
    numbers = rr.Points2D(
        np.concatenate([left, above]),
        radii=0.0,
        colors=palette.TITLE,
        labels=[str(i) for i in (*rows.tolist(), *columns.tolist())],
        show_labels=True,
    )
    recording.static((TABLE, "vertices"), numbers)


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
    shown = min(len(c.vertices), MOST_PLACEMENTS)
    points = [np.concatenate([extent(a), apply(c.transform[k], extent(b))]) for k in range(shown)]
    cells = arrange(points, [upright_rad(a.paths)] * shown, sheet_margin_m(points))
    recording.static((PLACEMENTS,), UP)
    titles = [(_title(e, k),) for k in range(shown)]
    write_cards(recording, PLACEMENTS, cells, titles)
    pen = pen_m([a, b])
    for k, cell in enumerate(cells):
        here = (PLACEMENTS, f"cluster {k + 1}")
        write_laid_over(recording, here, cell, (a, b), c.transform[k], pen=pen)
        matched = np.unique(h.vertex_a[c.of[h.of] == k])
        write_rings(recording, (*here, "matched"), a.xy[matched], 2.4 * pen)
    return cells


def _told(a: TopoMap, b: TopoMap, e: Explanation) -> str:
    h, c = e.hypotheses, e.clusters
    head = (
        f"# {plain(a.run)} - {plain(b.run)}\n\n{len(a)} by {len(b)} vertices, "
        f"{several(len(e.candidate_a), 'compatible pair')}, each rotation counted, "
        f"{several(len(h.size), 'hypothesis', 'hypotheses')}, "
        f"{several(len(c.vertices), 'cluster')}"
    )
    if len(c.vertices) == 0:
        fits = "none of them fits along its corridors"
        none = "no pair of junctions is compatible"
        return f"{head}: {fits if len(e.candidate_a) else none}.\n"
    rms = np.sqrt(c.squared_error / np.maximum(c.vertices, 1))
    clusters = [
        f"| {k + 1} | {c.vertices[k]} | {c.hypotheses[k]} | {c.largest[k]} | {rms[k]:.2f} "
        f"| {_pose(c.transform[k])} |"
        for k in range(min(len(c.vertices), MOST_ROWS))
    ]
    hypotheses = [
        f"| {i + 1} | {c.of[i] + 1 if c.of[i] >= 0 else ''} | {h.size[i]} | {h.corridors[i]} "
        f"| {np.sqrt(h.error[i]):.2f} | {_pose(h.transform[i])} |"
        for i in range(min(len(h.size), MOST_ROWS))
    ]
    return "\n\n".join(
        [
            head,
            "## Clusters\n\n| cluster | pairs | hypotheses | largest | rms, m | b over a |\n"
            "| ---: | ---: | ---: | ---: | ---: | --- |\n" + "\n".join(clusters),
            "## Hypotheses\n\n| no. | cluster | vertices | corridors | rms, m | b over a |\n"
            "| ---: | ---: | ---: | ---: | ---: | --- |\n" + "\n".join(hypotheses),
            f"At most {MOST_ROWS} rows of each are shown.\n",
        ]
    )


def _pose(pose: FloatArray) -> str:
    x, y = np.round(pose[:2], 1) + 0.0  # no minus before a zero
    return f"({x:.1f}, {y:.1f}) m, {np.round(np.degrees(pose[2])) + 0.0:.0f}°"


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
    spare = 2 * NUMBER_GAP * max(len(a), len(b), 1)
    return rrb.Spatial2DView(
        origin=f"/{TABLE}",
        name=f"Vertices of {a.run} (down) and {b.run} (across)",
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-spare, len(b) + spare / 2], y_range=[-spare, len(a) + spare / 2]
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
