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
from .scan_layers import WALLS_SO_FAR

MAP: PathParts = ("map",)

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


def map_blueprint(topomap: TopoMap, track: RobotTrack | None) -> rrb.Blueprint:
    """Blueprint of a map's recording: the map, and beside it its summary and the drift."""
    side: list[rrb.View | rrb.Container] = [
        rrb.Tabs(*_pages(topomap), active_tab=0, name="Details")
    ]
    if track is not None:
        side.append(_drift_view(1.8 * max(float(track.drift_m.max()), 0.1)))
    return _blueprint(
        rrb.Horizontal(
            _map_view(topomap, track, moving=track is not None),
            rrb.Vertical(*side, row_shares=[5, 2][: len(side)], name="Run"),
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
        pages.append(_drift_view())
    side = [rrb.Tabs(*pages, active_tab=0, name="Details")]
    if views:
        side.insert(0, rrb.Tabs(*views, active_tab=0, name="Raw log"))
    return _blueprint(
        rrb.Horizontal(
            _map_view(topomap, None, moving=True),
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


def _event_columns() -> rrb.TextLogColumns:
    return rrb.TextLogColumns(
        timeline_columns=[TimelineColumn(CLOCKS[0])],
        text_log_columns=[
            TextLogColumn(TextLogColumnKind.LogLevel),
            TextLogColumn(TextLogColumnKind.Body),
        ],
    )


def _map_view(topomap: TopoMap, track: RobotTrack | None, *, moving: bool) -> rrb.Spatial2DView:
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
        entity((*MAP, "scans", "walls")): WALLS_SO_FAR,
    }
    if moving:
        overrides[entity((*MAP, "detection"))] = _behind_cursor(DETECTION_S)
        overrides[entity((*MAP, "trail"))] = _behind_cursor(TRAIL_S)
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
