"""Blueprints: which views the viewer shows for the recording of one run's map."""

from __future__ import annotations

from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn, TextLogColumnKind, TimelineColumn

from ..topology.arrays import FloatArray
from ..topology.topomap import TopoMap
from .geometry import bounds
from .recording import CLOCKS, PathParts, blueprint, entity, map_view
from .robot_track import RobotTrack

MAP: PathParts = ("map",)

TRAIL_S, DETECTION_S = 60.0, 0.3
"""How long before the cursor the robot's trail and its detections are shown."""

WIDEST = 1.4
"""The view includes the recorded odometry unless it is larger than the map's by more than this
factor."""


def map_blueprint(topomap: TopoMap, track: RobotTrack | None) -> rrb.Blueprint:
    """Blueprint of a map's recording: the map, and beside it its summary, its events and the
    drift."""
    passed = len(topomap.observation_time_ns) > 0
    pages: list[rrb.View] = [rrb.TextDocumentView(origin="/summary", name="Summary")]
    if passed:
        pages.append(rrb.TextLogView(origin="/events", name="Events", columns=_EVENT_COLUMNS))
    side: list[rrb.View | rrb.Container] = [rrb.Tabs(*pages, active_tab=0, name="Details")]
    if track is not None:
        side.append(_drift_view(1.8 * max(float(track.drift_m.max()), 0.1)))
    root = rrb.Horizontal(
        _map_view(topomap, track),
        rrb.Vertical(*side, row_shares=[5, 2][: len(side)], name="Run"),
        column_shares=[3, 1],
        name="Map of one run",
    )
    state: Literal["collapsed", "hidden"] = "collapsed" if track or passed else "hidden"
    # "following" starts with the cursor at the end.
    end = rrb.TimePanel(state=state, timeline=CLOCKS[0], play_state="following")
    return blueprint(root, end)


_EVENT_COLUMNS = rrb.TextLogColumns(
    timeline_columns=[TimelineColumn(CLOCKS[0])],
    text_log_columns=[
        TextLogColumn(TextLogColumnKind.LogLevel),
        TextLogColumn(TextLogColumnKind.Body),
    ],
)


def _drift_view(most_m: float) -> rrb.TimeSeriesView:
    """Distance of recorded odometry and map over the whole run; most_m: upper end of the axis."""
    begin_to_end = rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
    return rrb.TimeSeriesView(
        origin="/drift",
        name="Drift [m]",
        axis_x=rrb.TimeAxis(view_range=begin_to_end),
        axis_y=rrb.ScalarAxis(range=(0.0, most_m)),
        plot_legend=rrb.PlotLegend(visible=True, corner=rrb.Corner2D.LeftTop),
    )


def _map_view(topomap: TopoMap, track: RobotTrack | None) -> rrb.Spatial2DView:
    """The view of the map, with the robot's recent track at the cursor."""
    shown: list[FloatArray] = [topomap.xy, *topomap.paths]
    low, high = bounds(shown)
    hidden = rrb.EntityBehavior(visible=False)
    overrides: dict[str, rrb.EntityBehavior | rrb.VisibleTimeRanges] = {
        entity((*MAP, "closures", "refused")): hidden,
    }
    if track is not None:
        wide_low, wide_high = bounds([*shown, *track.stretches(track.raw)])
        if np.all(wide_high - wide_low <= WIDEST * (high - low)):
            low, high = wide_low, wide_high
        overrides[entity((*MAP, "detection"))] = _behind_cursor(DETECTION_S)
        overrides[entity((*MAP, "trail"))] = _behind_cursor(TRAIL_S)
    return map_view(MAP, "Map", low, high, overrides)


def _behind_cursor(seconds: float) -> rrb.VisibleTimeRanges:
    """The time range from so many seconds before the cursor up to it."""
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
