"""The recording of one run's map, `maps/<run>.rrd`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn, TextLogColumnKind, TimelineColumn

from ..topology.arrays import FloatArray
from ..topology.driven_branches import driven_branches
from ..topology.odometry import Odometry
from ..topology.run import Detections, Grid, Scanned, ScanPasses
from ..topology.se2 import apply, compose
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from .geometry import MARGIN, MOST_NUMBERED, PENS, bounds, extent, pen_m
from .pages import ClosureText, closure_texts, map_page, visits
from .palette import DARK, LARGE, MEDIUM, RING, SMALL, THIN, Order, rgb
from .recording import (
    CLOCKS,
    HAIR,
    UP,
    PathParts,
    Recording,
    blueprint,
    entity,
    map_view,
    markdown,
    write_branches,
    write_corridors,
    write_grid,
    write_junctions,
    write_recording,
)
from .robot_track import MOST_POINTS, RobotTrack, robot_track
from .walls import walls_of

MAP: PathParts = ("map",)

TRAIL_S, DETECTION_S = 60.0, 0.3
"""How long before the cursor the robot's trail and its detections are shown."""

_CIRCLE = np.stack(
    [np.cos(np.linspace(0, 2 * np.pi, 25)), np.sin(np.linspace(0, 2 * np.pi, 25))], 1
)


def write_map_recording(
    path: Path,
    topomap: TopoMap,
    *,
    odometry: Odometry | None = None,
    detections: Detections | None = None,
    scanned: Scanned | None = None,
    grid: Grid | None = None,
) -> None:
    """Write the recording of one run's map, `maps/<run>.rrd`, atomically.

    odometry, detections, scanned: as recorded by the run; with odometry the recording shows what
    closing loops changed and where the robot is at any time, with the others what its detector or
    laser saw there. grid: the occupancy grid that the map was made from instead of a run. Raises
    OSError if the file cannot be written.
    """
    track = robot_track(topomap, odometry) if odometry is not None else None
    closures = closure_texts(topomap)

    def fill(recording: Recording) -> rrb.Blueprint:
        recording.static(MAP, UP)
        whole = with_turning_points(topomap)
        if grid is not None:
            write_grid(recording, (*MAP, "grid"), grid)
        _corridors(recording, whole)
        path, free = (*MAP, "branches never driven"), ~driven_branches(whole)
        write_branches(recording, path, whole, free, colour=DARK["orange"], pen=pen_m(whole))
        _junctions(recording, whole)
        _closures(recording, topomap, closures)
        _events(recording, topomap, closures, odometry)
        if track is not None:
            _track(recording, track)
            _drift(recording, track, topomap)
            if detections is not None:
                x, y = (_correction(topomap, name) for name in ("lever_x_m", "lever_y_m"))
                _detections(recording, detections.moved((-x, -y)), track, pen_m(whole))
            if scanned is not None:
                _scans(recording, scanned.passes, topomap, track)
        recording.static(("summary",), markdown(map_page(topomap, closures)))
        return _blueprint(topomap, track)

    write_recording(path, topomap.run, fill)


def _blueprint(topomap: TopoMap, track: RobotTrack | None) -> rrb.Blueprint:
    """The map, and beside it its summary, its events and the drift."""
    pages: list[rrb.View] = [rrb.TextDocumentView(origin="/summary", name="Summary")]
    if topomap.is_driven:
        pages.append(rrb.TextLogView(origin="/events", name="Events", columns=_EVENT_COLUMNS))
    side: list[rrb.View | rrb.Container] = [rrb.Tabs(*pages, active_tab=0, name="Details")]
    if track is not None:
        side.append(_drift_view())
    root = rrb.Horizontal(
        _map_view(topomap, track),
        rrb.Vertical(*side, row_shares=[5, 2][: len(side)], name="Run"),
        column_shares=[3, 1],
        name="Map of one run",
    )
    state: Literal["collapsed", "hidden"] = "collapsed" if track or topomap.is_driven else "hidden"
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


def _drift_view() -> rrb.TimeSeriesView:
    """Distance of recorded odometry and map over the whole run."""
    begin_to_end = rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
    return rrb.TimeSeriesView(
        origin="/drift",
        name="Drift [m]",
        axis_x=rrb.TimeAxis(view_range=begin_to_end),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _map_view(topomap: TopoMap, track: RobotTrack | None) -> rrb.Spatial2DView:
    """The view of the map, with the robot's recent track at the cursor."""
    driven = track.stretches(track.bent) if track is not None else []
    low, high = bounds([extent(with_turning_points(topomap)), *driven], 2 * MARGIN)
    hidden = rrb.EntityBehavior(visible=False)
    overrides: dict[str, rrb.EntityBehavior | rrb.VisibleTimeRanges] = {
        entity((*MAP, "closures", "refused")): hidden
    }
    if track is not None:
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


SHADES = ("dim", "single", "ink")
"""Greys of corridors, driven once, twice and more often."""


def _corridors(recording: Recording, topomap: TopoMap) -> None:
    """Write the corridors, brighter the more often they were driven."""
    times = np.clip(topomap.traversals, 1, len(SHADES))
    shades = [DARK[SHADES[k - 1]] for k in times.tolist()]
    lines = dict(enumerate(topomap.paths))
    path, pen = (*MAP, "corridors"), pen_m(topomap)
    write_corridors(recording, path, topomap, lines, colours=shades, pens=pen)


def _junctions(recording: Recording, topomap: TopoMap) -> None:
    """Write the vertices, coloured by their branches."""
    n = len(topomap)
    of_rooms = {"area_m2": topomap.area_m2, "width_m": topomap.width_m}
    sizes: dict[str, Any] = {name: size for name, size in of_rooms.items() if size is not None}
    pens = np.where(topomap.is_turned, SMALL, np.where(topomap.degree >= 3, LARGE, MEDIUM))
    values = {
        "headings_deg": [
            ", ".join(f"{h:.0f}" for h in np.degrees(topomap.branches[i])) for i in range(n)
        ],
        "passes": topomap.passes,
        "confidence": topomap.confidence,
        "position_sigma_m": topomap.position_sigma,
    }
    write_junctions(
        *(recording, (*MAP, "junctions"), topomap, np.arange(n)),
        colours=[DARK[f"degree {min(degree, 5)}"] for degree in topomap.degree.tolist()],
        sizes=pens * pen_m(topomap),
        more=values | sizes,
        numbered=n <= MOST_NUMBERED,
    )


def _closures(recording: Recording, topomap: TopoMap, closures: Sequence[ClosureText]) -> None:
    """Write every closure as a line of its own: an accepted one as a ring round its junction, the
    first one innermost; a refused one between the two junctions."""
    colours = {"accepted": DARK["track"], "refused": DARK["against"]}
    groups: dict[str, list[tuple[ClosureText, FloatArray]]] = {name: [] for name in colours}
    rings: Counter[int] = Counter()
    pen = pen_m(topomap)
    for shown in closures:
        a, b = shown.rows
        if a is None or b is None:  # a pass that belongs to no vertex has no position
            continue
        u, v = topomap.observation_vertex[[a, b]].tolist()
        if shown.closure.accepted and u == v:
            radius = pen * (LARGE + THIN * (rings[u] % PENS))  # after so many they begin anew
            rings[u] += 1
            groups["accepted"].append((shown, topomap.xy[u] + radius * _CIRCLE))
        elif u != v:
            name = "accepted" if shown.closure.accepted else "refused"
            groups[name].append((shown, topomap.xy[[u, v]]))
    for name, drawn in groups.items():
        if not drawn:
            continue
        ends = [[topomap.observation_vertex[k] for k in q.rows if k is not None] for q, _ in drawn]
        values = {
            "closure": [q.text for q, _ in drawn],
            "junctions": [", ".join(map(str, dict.fromkeys(pair))) for pair in ends],
            "bits": np.array([q.closure.bits for q, _ in drawn]),
            "reason": [q.closure.reason for q, _ in drawn],
        }
        path, lines = (*MAP, "closures", name), [line for _, line in drawn]
        recording.lines(path, lines, Order.CLOSURE, colours[name], values, radii=HAIR)


def _events(
    recording: Recording,
    topomap: TopoMap,
    closures: Sequence[ClosureText],
    odometry: Odometry | None,
) -> None:
    """Write a log of passes, closures, and what is wrong with the odometry."""
    time_ns, vertex = topomap.observation_time_ns, topomap.observation_vertex
    if len(time_ns) == 0:
        return
    kinds = [topomap.kind[v].replace("_", " ") for v in vertex.tolist()]
    log = [
        (t, "INFO", f"{kind} {v}, visit {visit}")
        for t, kind, v, visit in zip(
            time_ns.tolist(), kinds, vertex.tolist(), visits(topomap).tolist(), strict=True
        )
    ]
    log += [
        (q.closure.time_b_ns, "INFO" if q.closure.accepted else "WARN", q.text) for q in closures
    ]
    if odometry is not None:
        for rows, what in ((odometry.jumps, "jumps"), (odometry.breaks, "breaks")):
            log += [(t, "WARN", f"the odometry {what}") for t in odometry.time_ns[rows].tolist()]
    log.sort()
    recording.over_time(
        ("events",),
        np.array([t for t, _, _ in log], np.int64),
        rr.TextLog.columns(text=[text for _, _, text in log], level=[level for _, level, _ in log]),
    )


def _drift(recording: Recording, track: RobotTrack, topomap: TopoMap) -> None:
    """Write the distance of the recorded odometry from the map, plus and minus the map's own
    uncertainty [m]."""
    times = topomap.observation_time_ns
    sigma = np.full(len(times), topomap.measured.centre_m)
    if topomap.position_sigma is not None:
        sigma = np.hypot(sigma, topomap.position_sigma[topomap.observation_vertex])
    series = {
        "drift": (track.drift_m, DARK["orange"], "recorded odometry off the map [m]", 2.0),
        "plus sigma": (track.drift_m + sigma, DARK["dim"], "+1 sigma [m]", 1.0),
        "minus sigma": (np.maximum(track.drift_m - sigma, 0.0), DARK["dim"], "-1 sigma [m]", 1.0),
    }
    for name, (values, colour, label, width) in series.items():
        path = ("drift", name)
        recording.over_time(path, times, rr.Scalars.columns(scalars=values))
        recording.static(path, rr.SeriesLines(colors=rgb(colour), names=label, widths=width))


def _track(recording: Recording, track: RobotTrack) -> None:
    """Write the odometry's track as recorded and as corrected, and the robot on it."""
    for name, pose, colour, order in (
        ("recorded", track.raw, DARK["faint"], Order.RECORDED),
        ("corrected", track.bent, DARK["track"], Order.CORRECTED),
    ):
        if lines := track.stretches(pose):
            recording.lines((*MAP, "odometry", name), lines, order, colour, radii=HAIR)
    xy = track.bent[:, :2]
    for name, size, colour, order in (
        ("robot", RING, DARK["ink"], Order.ROBOT),
        ("trail", SMALL, DARK["green"], Order.TIE),
    ):
        recording.over_time((*MAP, name), track.time_ns, rr.Points2D.columns(positions=xy))
        radii = rr.Radius.ui_points(size)
        look = rr.Points2D.from_fields(radii=radii, colors=rgb(colour), draw_order=order)
        recording.static((*MAP, name), look)


def _detections(
    recording: Recording, detections: Detections, track: RobotTrack, pen: float
) -> None:
    """Write every detection as a dot, and over time its branches as a star, at the poses of the
    corrected track. Detections outside of the track's time range are left out."""
    time_ns = detections.time_ns
    rows = np.flatnonzero((time_ns >= track.time_ns[0]) & (time_ns <= track.time_ns[-1]))
    if len(rows) == 0:
        return
    rows = rows[:: max(1, -(-len(rows) // MOST_POINTS))]
    pose = track.at(time_ns[rows])
    ahead = np.column_stack([detections.centre[rows], np.zeros(len(rows))])
    centre = compose(pose, ahead)[:, :2]
    colour, radii = DARK["violet"], rr.Radius.ui_points(1.0)
    recording.dots((*MAP, "detections"), centre, Order.SIGHTING, colour, radii=radii)
    branches = detections.branches.take(rows)
    theta = branches.values + pose[branches.owner, 2]
    ends = RING * pen * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    strips = np.stack([centre[branches.owner], centre[branches.owner] + ends], axis=1)
    seen = branches.counts > 0
    if not seen.any():
        return
    columns = rr.LineStrips2D.columns(strips=list(strips)).partition(branches.counts[seen])
    recording.over_time((*MAP, "detection"), time_ns[rows][seen], columns)
    star = rr.LineStrips2D.from_fields(radii=radii, colors=rgb(colour), draw_order=Order.SEEN)
    recording.static((*MAP, "detection"), star)


SURE = 5.5 / 7
"""Confidence above which a junction is drawn as sure: six of the detector's seven variants
agree."""


def _scans(recording: Recording, passes: ScanPasses, topomap: TopoMap, track: RobotTrack) -> None:
    """Write the walls and the free space of the map's views, and the junctions of a run's scans,
    placed on the map by the track."""
    walls = walls_of([topomap.views], topomap.frame)
    if walls is not None:
        write_grid(recording, (*MAP, "scans", "walls"), walls)
    if len(passes) == 0:
        return
    sure = (passes.confidence > SURE).tolist()
    values = {
        "seen": np.arange(len(passes)),
        "confidence": passes.confidence,
        "branches": passes.branches.counts,
        "windows": passes.windows,
        "clearance_m": passes.clearance_m,
    }
    recording.dots(
        (*MAP, "scans", "junctions"),
        apply(track.at(passes.time_ns), passes.centre),
        Order.TIE,
        [DARK["violet" if own else "doubtful"] for own in sure],
        values,
        radii=rr.Radius.ui_points(SMALL),
    )


def _correction(topomap: TopoMap, name: str) -> float:
    """What the map was corrected by, by its name in `graph.calibration`; 0 if it was not."""
    error = topomap.info.get("calibration", {}).get(name)
    return 0.0 if error is None else float(error["applied"])
