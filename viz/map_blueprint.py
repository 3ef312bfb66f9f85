"""Blueprints: which views the viewer shows for the recording of one run's map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn, TextLogColumnKind, TimelineColumn

from ..topology.arrays import FloatArray
from ..topology.topomap import TopoMap
from .drawing import bounds
from .recording import CLOCKS, PathParts, blueprint, entity, map_view
from .robot_track import RobotTrack
from .scan_layers import overrides_of_scans

MAP: PathParts = ("map",)

MOST_NODES = 300
"""Above this many vertices the graph view is left out."""

GRAPH_CORRIDOR = 90.0
"""Length of the median corridor in the graph view, where a node is about 20 units wide."""

TRAIL_S, DETECTION_S = 60.0, 0.3
"""How long before the cursor the robot's trail and its detections are shown."""

WIDEST = 1.4
"""The view includes the recorded odometry unless it is larger than the map's by more than this
factor."""

WHOLE_RUN = rrb.TimeAxis(
    view_range=rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
)


def map_blueprint(
    topomap: TopoMap, track: RobotTrack | None, *, health: bool, scans: bool
) -> rrb.Blueprint:
    """Blueprint of a map's recording: the map, and beside it its summary, the drift and the health
    of the odometry."""
    side: list[rrb.View | rrb.Container] = [
        rrb.Tabs(*_pages(topomap), active_tab=0, name="Details")
    ]
    if track is not None:
        side.append(_drift_view(1.8 * max(float(track.drift_m.max()), 0.1)))
    if health:
        side.append(_health_view())
    return _blueprint(
        rrb.Horizontal(
            _maps(topomap, track, moving=track is not None, scans=scans),
            rrb.Vertical(*side, row_shares=[5, 2, 2][: len(side)], name="Run"),
            column_shares=[3, 1],
            name="Map of one run",
        ),
        in_time=track is not None or len(topomap.observation_time_ns) > 0,
    )


def log_blueprint(topomap: TopoMap, views: Sequence[rrb.View]) -> rrb.Blueprint:
    """Blueprint of a map with its log: the map, and beside it views of the raw log at the same
    time."""
    pages = _pages(topomap)
    if len(topomap.observation_time_ns):
        pages += [_drift_view(), _health_view()]
    side = [rrb.Tabs(*pages, active_tab=0, name="Details")]
    if views:
        side.insert(0, rrb.Tabs(*views, active_tab=0, name="Raw log"))
    return _blueprint(
        rrb.Horizontal(
            _maps(topomap, None, moving=True, scans=True),
            rrb.Vertical(*side, row_shares=[3, 2][: len(side)], name="Run"),
            column_shares=[3, 2],
            name="Map and raw log of one run",
        ),
        in_time=True,
    )


def _blueprint(root: rrb.Container, *, in_time: bool) -> rrb.Blueprint:
    """in_time: the recording has a time axis, so the time panel is shown."""
    state: Literal["collapsed", "hidden"] = "collapsed" if in_time else "hidden"
    # "following" starts with the cursor at the end, where the whole map is shown.
    end = rrb.TimePanel(state=state, timeline=CLOCKS[0], play_state="following")
    return blueprint(root, end)


def _maps(
    topomap: TopoMap, track: RobotTrack | None, *, moving: bool, scans: bool
) -> rrb.Container:
    views: list[rrb.View] = [_map_view(topomap, track, moving=moving, scans=scans)]
    if 0 < len(topomap) <= MOST_NODES:
        low, high = bounds([on_graph(topomap)])
        around = rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[low[1], high[1]])
        views.append(rrb.GraphView(origin="/graph", name="Graph", visual_bounds=around))
    return rrb.Tabs(*views, active_tab=0, name="Maps")


def on_graph(topomap: TopoMap) -> FloatArray:
    """(n, 2) positions of the vertices in the graph view; y points down."""
    usual = float(np.median(topomap.length)) if len(topomap.length) else 1.0
    return GRAPH_CORRIDOR / usual * topomap.xy * [1.0, -1.0]


def _pages(topomap: TopoMap) -> list[rrb.View]:
    pages: list[rrb.View] = [rrb.TextDocumentView(origin="/summary", name="Summary")]
    if len(topomap.observation_time_ns):
        pages.append(rrb.TextLogView(origin="/events", name="Events", columns=_event_columns()))
    return pages


def _drift_view(most_m: float | None = None) -> rrb.TimeSeriesView:
    """Distance of recorded odometry and map over the whole run; most_m: upper end of the axis."""
    return rrb.TimeSeriesView(
        origin="/drift",
        name="Drift [m]",
        axis_x=WHOLE_RUN,
        axis_y=None if most_m is None else rrb.ScalarAxis(range=(0.0, most_m)),
        plot_legend=rrb.PlotLegend(visible=True, corner=rrb.Corner2D.LeftTop),
    )


def _health_view() -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin="/health", name="Odometry, health", time_view=WHOLE_RUN)


def _event_columns() -> rrb.TextLogColumns:
    return rrb.TextLogColumns(
        timeline_columns=[TimelineColumn(CLOCKS[0])],
        text_log_columns=[
            TextLogColumn(TextLogColumnKind.LogLevel),
            TextLogColumn(TextLogColumnKind.Body),
        ],
    )


def _map_view(
    topomap: TopoMap, track: RobotTrack | None, *, moving: bool, scans: bool
) -> rrb.Spatial2DView:
    """moving: show what happened shortly before the cursor."""
    shown: list[FloatArray] = [topomap.xy, *topomap.paths]
    low, high = bounds(shown)
    if track is not None:
        wide_low, wide_high = bounds([*shown, *track.stretches])
        if np.all(wide_high - wide_low <= WIDEST * (high - low)):
            low, high = wide_low, wide_high
    hidden = rrb.EntityBehavior(visible=False)
    overrides: dict[str, rrb.EntityBehavior | rrb.VisibleTimeRanges] = {
        entity((*MAP, "branches driven")): hidden,
        entity((*MAP, "closures", "refused")): hidden,
    }
    if moving:
        overrides[entity((*MAP, "detection"))] = _behind_cursor(DETECTION_S)
        overrides[entity((*MAP, "trail"))] = _behind_cursor(TRAIL_S)
    if scans:
        overrides |= overrides_of_scans(MAP)
    return map_view(MAP[0], "Map", low, high, overrides)


def _behind_cursor(seconds: float) -> rrb.VisibleTimeRanges:
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                clock,
                start=rr.TimeRangeBoundary.cursor_relative(seconds=-seconds),
                end=rr.TimeRangeBoundary.cursor_relative(),
            )
            for clock in CLOCKS
        ]
    )
