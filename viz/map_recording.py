"""The recording of one run's map, `maps/<run>.rrd`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.encodings import TextLogColumn, TextLogColumnKind, TimelineColumn

from ..topology.odometry import Odometry
from ..topology.topomap import Closure, TopoMap
from . import palette
from .drawing import bounds, branch_arrows, driven_branches, pen_m
from .map_summary import map_summary
from .recording import (
    CLOCKS,
    UP,
    PathParts,
    Recording,
    entity,
    map_view,
    markdown,
    write_recording,
)
from .robot_track import RobotTrack, robot_track

MOST_LABELS = 150
"""Above this many vertices, numbers on the map hide more than they tell: hover shows them."""

MOST_NODES = 300
"""Above this many vertices there is no room for a graph of boxes."""

GRAPH_CORRIDOR = 90.0
"""The usual corridor's length in the graph, in units of which a node takes about twenty."""

TRAIL_S = 60.0

MAP: PathParts = ("map",)


def write(path: Path, topomap: TopoMap, odometry: Odometry | None) -> None:
    """Write the recording of a map; see `topobatch.viz.write_map_recording`."""
    track = robot_track(topomap, odometry) if odometry is not None else None

    def fill(recording: Recording) -> rrb.Blueprint:
        recording.static(MAP, UP)
        _corridors(recording, topomap)
        _branches(recording, topomap)
        _junctions(recording, topomap)
        _graph(recording, topomap)
        _refused(recording, topomap)
        _visits(recording, topomap)
        if track is not None:
            _track(recording, track, topomap)
        recording.static(("summary",), markdown(map_summary(topomap)))
        return _blueprint(topomap, track)

    write_recording(path, topomap.run, fill)


def _corridors(recording: Recording, topomap: TopoMap) -> None:
    if len(topomap.source) == 0:
        return
    share = np.clip((topomap.traversals - 1) / 3.0, 0.0, 1.0)[:, None]
    dull, bright = np.array(palette.CORRIDOR), np.array(palette.WHITE)
    recording.static(
        (*MAP, "corridors"),
        rr.LineStrips2D(
            list(topomap.paths),
            radii=pen_m([topomap]) / 2,
            colors=(dull + 0.45 * share * (bright - dull)).astype(np.uint8),
            draw_order=10.0,
        ),
        rr.AnyValues(
            corridor=np.arange(len(topomap.source)),
            between=[f"{u} - {v}" for u, v in zip(topomap.source, topomap.target, strict=True)],
            length_m=topomap.length,
            length_sigma_m=topomap.length_sigma,
            traversals=topomap.traversals,
        ),
    )


def _branches(recording: Recording, topomap: TopoMap) -> None:
    driven = driven_branches(topomap)
    pen = pen_m([topomap])
    origins, vectors = branch_arrows(topomap, 7 * pen)
    layers = (
        ("branches driven", driven, palette.DIM, 12.0),
        ("branches never driven", ~driven, palette.UNEXPLORED, 14.0),
    )
    for name, which, colour, order in layers:
        if which.any():
            arrows = rr.Arrows2D(
                origins=origins[which],
                vectors=vectors[which],
                radii=pen / 3,
                colors=colour,
                draw_order=order,
            )
            recording.static((*MAP, name), arrows)


def _junctions(recording: Recording, topomap: TopoMap) -> None:
    n = len(topomap)
    if n == 0:
        return
    passes = np.bincount(topomap.observation_vertex, minlength=n)
    recording.static(
        (*MAP, "junctions"),
        rr.Points2D(
            topomap.xy,
            radii=np.where(topomap.degree >= 3, 2.2, 1.6) * pen_m([topomap]),
            colors=palette.by_degree(topomap.degree),
            labels=[str(i) for i in range(n)],
            show_labels=n <= MOST_LABELS,
            draw_order=20.0,
        ),
        rr.AnyValues(
            vertex=np.arange(n),
            kind=list(topomap.kind),
            branches=topomap.degree,
            headings_deg=[
                ", ".join(f"{h:.0f}" for h in np.degrees(topomap.branches[i])) for i in range(n)
            ],
            passes=passes,
        ),
    )


def _on_graph(topomap: TopoMap) -> NDArray[np.float64]:
    """(n, 2) where the vertices lie in the graph; y points down."""
    usual = float(np.median(topomap.length)) if len(topomap.length) else 1.0
    return GRAPH_CORRIDOR / usual * topomap.xy * [1.0, -1.0]


def _graph(recording: Recording, topomap: TopoMap) -> None:
    """The map as boxes and straight lines: its topology without its shape."""
    if not 0 < len(topomap) <= MOST_NODES:
        return
    ids = [str(i) for i in range(len(topomap))]
    nodes = rr.GraphNodes(
        ids,
        labels=ids,
        colors=palette.by_degree(topomap.degree),
        positions=_on_graph(topomap),
    )
    ends = zip(topomap.source.tolist(), topomap.target.tolist(), strict=True)
    edges = [(str(u), str(v)) for u, v in ends if u != v]
    recording.static(("graph",), nodes, *([rr.GraphEdges(edges)] if edges else []))


def _refused(recording: Recording, topomap: TopoMap) -> None:
    """Thin lines between visits that were not taken for the same place."""
    seen = dict(
        zip(
            topomap.observation_time_ns.tolist(),
            topomap.observation_vertex.tolist(),
            strict=True,
        )
    )
    visits = [
        (c, seen.get(c.time_a_ns), seen.get(c.time_b_ns))
        for c in topomap.closures
        if not c.accepted and not c.revised
    ]
    # A visit that ended in no vertex (a phantom, say) has no place to draw a line from.
    apart = [(c, a, b) for c, a, b in visits if a is not None and b is not None and a != b]
    if not apart:
        return
    recording.static(
        (*MAP, "loops refused"),
        rr.LineStrips2D(
            [topomap.xy[[a, b]] for _, a, b in apart],
            radii=rr.Radius.ui_points(0.75),
            colors=palette.REFUSED,
            draw_order=5.0,
        ),
        rr.AnyValues(
            bits=np.array([c.bits for c, _, _ in apart]), reason=[c.reason for c, _, _ in apart]
        ),
    )


def _visits(recording: Recording, topomap: TopoMap) -> None:
    """The junction passed last, and a log of passes and closures."""
    time_ns, vertex = topomap.observation_time_ns, topomap.observation_vertex
    if len(time_ns) == 0:
        return
    ring = rr.Points2D.columns(
        positions=topomap.xy[vertex], radii=np.full(len(vertex), 3.4 * pen_m([topomap]))
    )
    recording.over_time((*MAP, "last junction"), time_ns, ring)
    recording.static(
        (*MAP, "last junction"),
        rr.Points2D.from_fields(colors=palette.TRAIL, draw_order=15.0),
    )
    log = sorted([*_pass_lines(topomap), *map(_closure_line, _standing(topomap))])
    recording.over_time(
        ("events",),
        np.array([t for t, _, _ in log], np.int64),
        rr.TextLog.columns(text=[text for _, _, text in log], level=[level for _, level, _ in log]),
    )


def _standing(topomap: TopoMap) -> list[Closure]:
    """Answers that no later round replaced."""
    return [c for c in topomap.closures if not c.revised]


def _pass_lines(topomap: TopoMap) -> list[tuple[int, str, str]]:
    visits = np.zeros(len(topomap), np.int64)
    lines = []
    for time_ns, vertex in zip(
        topomap.observation_time_ns.tolist(), topomap.observation_vertex.tolist(), strict=True
    ):
        visits[vertex] += 1
        kind = topomap.kind[vertex].replace("_", " ")
        lines.append((time_ns, "INFO", f"{kind} {vertex}, visit {visits[vertex]}"))
    return lines


def _closure_line(closure: Closure) -> tuple[int, str, str]:
    word, level = ("recognised", "INFO") if closure.accepted else ("refused", "WARN")
    return closure.time_b_ns, level, f"loop {word} ({closure.bits:+.1f} bits): {closure.reason}"


def _track(recording: Recording, track: RobotTrack, topomap: TopoMap) -> None:
    if track.stretches:
        recording.static(
            (*MAP, "raw odometry"),
            rr.LineStrips2D(
                track.stretches,
                radii=rr.Radius.ui_points(0.75),
                colors=palette.RAW,
                draw_order=2.0,
            ),
        )
    xy = track.bent[:, :2]
    recording.over_time((*MAP, "robot"), track.time_ns, rr.Points2D.columns(positions=xy))
    robot = rr.Points2D.from_fields(
        radii=rr.Radius.ui_points(7.0), colors=palette.ROBOT, draw_order=40.0
    )
    recording.static((*MAP, "robot"), robot)
    recording.over_time((*MAP, "trail"), track.time_ns, rr.Points2D.columns(positions=xy))
    trail = rr.Points2D.from_fields(
        radii=rr.Radius.ui_points(2.5), colors=palette.TRAIL, draw_order=30.0
    )
    recording.static((*MAP, "trail"), trail)
    drift = rr.Scalars.columns(scalars=track.drift_m)
    recording.over_time(("drift",), topomap.observation_time_ns, drift)
    recording.static(
        ("drift",), rr.SeriesLines(colors=palette.UNEXPLORED, names="raw odometry to map, m")
    )


def _blueprint(topomap: TopoMap, track: RobotTrack | None) -> rrb.Blueprint:
    views: list[rrb.View] = [_map_view(topomap, track)]
    if 0 < len(topomap) <= MOST_NODES:
        low, high = bounds([_on_graph(topomap)], margin=0.05)
        around = rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[low[1], high[1]])
        views.append(rrb.GraphView(origin="/graph", name="Graph", visual_bounds=around))
    pages: list[rrb.View] = [rrb.TextDocumentView(origin="/summary", name="Summary")]
    if len(topomap.observation_time_ns):
        pages.append(rrb.TextLogView(origin="/events", name="Events", columns=_event_columns()))
    if track is not None:
        pages.append(_drift_view(track))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(*views, active_tab=0, name="Maps"),
            rrb.Tabs(*pages, active_tab=0, name="Details"),
            column_shares=[3, 1],
            name="Map of one run",
        ),
        rrb.BlueprintPanel(state="expanded"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=CLOCKS[0], play_state="paused"),
        auto_layout=False,
        auto_views=False,
    )


def _drift_view(track: RobotTrack) -> rrb.TimeSeriesView:
    """How far the raw odometry is from the map, over the whole run."""
    all_times = rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
    return rrb.TimeSeriesView(
        origin="/drift",
        name="Drift",
        axis_x=rrb.TimeAxis(view_range=all_times),
        axis_y=rrb.ScalarAxis(range=(0.0, 1.1 * max(float(track.drift_m.max()), 0.1))),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _event_columns() -> rrb.TextLogColumns:
    return rrb.TextLogColumns(
        timeline_columns=[TimelineColumn(CLOCKS[0])],
        text_log_columns=[
            TextLogColumn(TextLogColumnKind.LogLevel),
            TextLogColumn(TextLogColumnKind.Body),
        ],
    )


def _map_view(topomap: TopoMap, track: RobotTrack | None) -> rrb.Spatial2DView:
    shown: list[NDArray[np.float64]] = [topomap.xy, *topomap.paths]
    low, high = bounds([*shown, *(track.stretches if track is not None else [])], margin=0.05)
    hidden = rrb.EntityBehavior(visible=False)
    overrides: dict[str, rrb.EntityBehavior | rrb.VisibleTimeRanges] = {
        entity((*MAP, name)): hidden for name in ("branches driven", "loops refused")
    }
    if track is not None:
        trail = rrb.VisibleTimeRanges(
            [
                rrb.VisibleTimeRange(
                    clock,
                    start=rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
                    end=rr.TimeRangeBoundary.cursor_relative(),
                )
                for clock in CLOCKS
            ]
        )
        overrides[entity((*MAP, "trail"))] = trail
    return map_view(MAP[0], "Map", low, high, overrides)
