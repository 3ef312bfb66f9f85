"""Recording of a run's map together with its raw log, and the blueprint of both.

The viewer decodes ROS 2 messages but draws neither odometry nor laser scans, so that speeds and
echoes are added here. Other messages are drawn by the viewer where it can, or listed as tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import Chunk, LazyChunkStream, McapReader, RrdReader

from ..topology.errors import LogError
from ..topology.files import write_atomically
from ..topology.ragged import numbered
from ..topology.topomap import TopoMap
from . import palette
from .map_blueprint import WHOLE_RUN, log_blueprint
from .map_summary import plain
from .recording import (
    APPLICATION_ID,
    CLOCKS,
    PathParts,
    Recording,
    entity,
    markdown,
    write_recording,
)

LOG = "/log"
"""Root of the topics, so that a topic /map does not collide with the map."""

TOPICS: PathParts = ("topics",)

MAGIC = b"\x89MCAP0\r\n"

IN_SPACE = ("Points3D", "LineStrips3D", "Boxes3D", "Mesh3D", "GridMap", "Arrows3D")
"""Archetypes of decoded messages that the viewer draws in 3D."""
IMAGES = ("Image", "EncodedImage", "DepthImage", "EncodedDepthImage", "VideoStream")

Messages = Any
"""Arrow struct array of a topic's messages."""

Drawn = dict[str, tuple[Any, Any]]
"""For each entity below the topic's: columns with a row for each message (or none), and static
columns."""


def write_raw_log(path: Path, views: Path, log: Path, recording: Path, topomap: TopoMap) -> None:
    """Write the recording of a run's map with its raw log, an MCAP file or a folder of them: topics
    lie below /log on the map's timelines.

    recording: of the map; views: file for a blueprint to open before `path`. Raises LogError if the
    viewer cannot read the log, OSError if a file cannot be written.
    """
    files = sorted(log.glob("*.mcap")) if log.is_dir() else [log]
    if not files or not all(map(_is_mcap, files)):
        raise LogError(
            f"{log}: the viewer reads raw logs in MCAP only; look at the map without --with-log"
        )
    held: dict[str, set[str]] = {}

    def save(temporary: Path) -> None:
        try:
            streams = [
                McapReader(file).stream().flat_map(lambda c: _with_drawn(c, held)) for file in files
            ]
            # Without the blueprint of the map alone: of two, the viewer may take either.
            both = LazyChunkStream.merge(RrdReader(recording).stream(), *streams)
            both.write_rrd(temporary, application_id=APPLICATION_ID, recording_id=topomap.run)
        except ValueError as error:
            raise LogError(
                f"{log}: the viewer cannot read it: {error}; `mcap recover` may mend it"
            ) from error

    write_atomically(path, save)
    write_recording(views, topomap.run, lambda page: _shown(page, topomap, held))


def _is_mcap(file: Path) -> bool:
    with file.open("rb") as opened:
        return opened.read(len(MAGIC)) == MAGIC


def _with_drawn(chunk: Chunk, held: dict[str, set[str]]) -> Iterator[Chunk]:
    """The chunk moved below LOG, and the chunks drawn from its messages; adds its components to
    `held`."""
    topic = chunk.entity_path
    yield chunk.with_entity_path(f"{LOG}{topic}")
    if chunk.is_static:
        return
    batch = chunk.to_record_batch()
    clocks = [clock for clock in CLOCKS if clock in chunk.timeline_names]
    components = {name for name in batch.schema.names if ":" in name}
    held.setdefault(topic, set()).update(components)
    for component, drawing in DRAWN.items():
        if component not in components or CLOCKS[0] not in clocks:
            continue
        message = batch.column(component).flatten()
        if len(message) != len(batch) or message.null_count:
            continue
        indexes = [
            rr.TimeColumn(c, timestamp=batch.column(c).to_numpy(zero_copy_only=False))
            for c in clocks
        ]
        for name, (columns, look) in drawing(message).items():
            place = f"{LOG}{topic}/{name}"
            if columns:
                yield Chunk.from_columns(place, indexes, columns)
            yield Chunk.from_columns(place, [], look)


def _at(message: Messages, *names: str) -> NDArray[Any]:
    """A nested numeric field of all messages, (n,)."""
    for name in names:
        message = message.field(name)
    return np.asarray(message.to_numpy(zero_copy_only=False))


def _speeds(message: Messages) -> Drawn:
    """Forward [m/s] and angular [rad/s] speeds of the odometry."""
    out: Drawn = {}
    for name, field, colour in (
        ("forward", ("linear", "x"), palette.TRAIL),
        ("turning", ("angular", "z"), palette.UNEXPLORED),
    ):
        speed = rr.Scalars.columns(scalars=_at(message, "twist", "twist", *field))
        out[name] = speed, rr.SeriesLines.columns(colors=[colour], names=[name])
    return out


def _laser(message: Messages) -> Drawn:
    """Echoes in the laser's frame, with its x axis upwards (the view's y points down)."""
    ranges = message.field("ranges")
    count = np.diff(ranges.offsets.to_numpy(zero_copy_only=False))
    reach = ranges.flatten().to_numpy(zero_copy_only=False).astype(np.float64)
    row, beam = numbered(count)
    angle = _at(message, "angle_min")[row] + beam * _at(message, "angle_increment")[row]
    echo = (reach >= _at(message, "range_min")[row]) & (reach < _at(message, "range_max")[row])
    reach, angle, row = reach[echo], angle[echo], row[echo]
    ahead_up = np.column_stack([-reach * np.sin(angle), -reach * np.cos(angle)])
    seen = np.bincount(row, minlength=len(message))
    points = rr.Points2D.columns(positions=ahead_up.astype(np.float32)).partition(seen)
    look = rr.Points2D.columns(colors=[palette.DETECTION], radii=rr.Radius.ui_points([1.5]))
    here = rr.Points2D.columns(
        positions=[[0.0, 0.0]], colors=[palette.ROBOT], radii=rr.Radius.ui_points([5.0])
    )
    return {"echoes": (points, look), "laser": ((), here)}


DRAWN: dict[str, Callable[[Messages], Drawn]] = {
    "nav_msgs.msg.Odometry:message": _speeds,
    "sensor_msgs.msg.LaserScan:message": _laser,
}
"""Drawing functions for messages that the viewer decodes but does not draw."""


def _shown(page: Recording, topomap: TopoMap, held: dict[str, set[str]]) -> rrb.Blueprint:
    """The blueprint, and a page that lists the topics of the log."""
    lines = [
        f"- {plain(topic)}: {plain(', '.join(sorted(n.split(':')[0] for n in held[topic])))}"
        for topic in sorted(held)
    ]
    head = "# Raw log\n\nTopics, and what the viewer knows their messages as:\n\n"
    page.static(TOPICS, markdown(head + "\n".join(lines)))
    listed = rrb.TextDocumentView(origin=entity(TOPICS), name="Topics")
    return log_blueprint(topomap, [*_views(held), listed])


def _views(held: dict[str, set[str]]) -> list[rrb.View]:
    """A view for every topic, drawn ones first; topics with transforms only have none."""
    drawn: list[rrb.View] = []
    tables: list[rrb.View] = []
    for topic in sorted(held):
        shown, place = {name.split(":")[0] for name in held[topic]}, f"{LOG}{topic}"
        if "sensor_msgs.msg.LaserScan" in shown:
            drawn.append(_laser_view(place, topic))
        elif "nav_msgs.msg.Odometry" in shown:
            drawn.append(_speed_view(place, topic))
        elif shown & set(IMAGES):
            drawn.append(rrb.Spatial2DView(origin=place, name=topic))
        elif shown & set(IN_SPACE):
            drawn.append(rrb.Spatial3DView(origin=place, contents=f"{LOG}/**", name=topic))
        elif "TextLog" in shown:
            drawn.append(rrb.TextLogView(origin=place, name=topic))
        elif "Transform3D" not in shown:
            tables.append(_table(place, topic))
    return drawn + tables


def _laser_view(place: str, topic: str) -> rrb.View:
    return rrb.Spatial2DView(
        origin=place,
        contents=[f"{place}/echoes", f"{place}/laser"],
        name=f"{topic}, ahead is up",
        background=palette.BACKGROUND,
    )


def _speed_view(place: str, topic: str) -> rrb.View:
    return rrb.TimeSeriesView(
        origin=place,
        contents=[f"{place}/forward", f"{place}/turning"],
        name=f"{topic} [m/s, rad/s]",
        axis_x=WHOLE_RUN,
        plot_legend=rrb.PlotLegend(visible=True, corner=rrb.Corner2D.LeftTop),
    )


def _table(place: str, topic: str) -> rrb.View:
    """A table of the topic's messages that follows the cursor."""
    query = rrb.archetypes.DataframeQuery(timeline=CLOCKS[0], auto_scroll=True)
    return rrb.DataframeView(origin=place, contents=place, name=topic, query=query)
