"""Rerun recordings: opening and closing them, views, and what several of them hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings
from PIL import Image

from ..merge.decision_text import short
from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.files import write_atomically
from ..topology.run import Grid
from ..topology.topomap import Graph
from .geometry import branch_arrows
from .palette import DARK, THIN, Colour, Order, rgb
from .sheet import ASPECT, Cell, corners_of, outline

APPLICATION_ID = "topobatch"

CLOCKS = ("message_log_time", "ros2_timestamp")
"""Timelines of a raw log as rerun names them: the map uses the same, to share the cursor."""

UP = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
"""Mirrors y: it points down in the viewer's 2D views."""

HAIR = rr.Radius.ui_points(THIN)
"""The thinnest line that is visible on every screen [points]."""

PathParts = tuple[str, ...]

NOTHING: Mapping[str, Any] = MappingProxyType({})


class Recording:
    """A recording being written. Entity paths are given as parts, so that a part may hold any
    characters.

    No wall-clock time is logged and chunks are not split by time, so that the same results give the
    same content by `rerun rrd compare --unordered`. The bytes differ: rerun assigns random ids to
    rows, chunks and blueprints.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream

    def static(self, path: PathParts, *parts: rr.AsComponents) -> None:
        """Log components without a time."""
        first, *more = parts
        self._stream.log(entity(path), first, *more, static=True)

    def dots(
        self,
        path: PathParts,
        xy: FloatArray | Sequence[Any],
        order: Order,
        colours: Colour | Sequence[Colour],
        values: Mapping[str, Any] = NOTHING,
        **look: Any,
    ) -> None:
        """Log points (n, 2) without a time, in one colour or one each. values: of each,
        by component; look: of rerun's Points2D."""
        shape = rr.Points2D(xy, colors=_rgbs(colours), draw_order=order, **look)
        self.static(path, shape, *_any_values(values))

    def words(
        self,
        path: PathParts,
        xy: Sequence[Any],
        texts: Sequence[str],
        colours: Colour | Sequence[Colour],
    ) -> None:
        """Log texts at points (n, 2) without a time, in one colour or one each."""
        self.dots(path, xy, Order.WORDS, colours, radii=0.0, labels=texts, show_labels=True)

    def lines(
        self,
        path: PathParts,
        lines: Sequence[FloatArray],
        order: Order,
        colours: Colour | Sequence[Colour],
        values: Mapping[str, Any] = NOTHING,
        **look: Any,
    ) -> None:
        """Log polylines, (k, 2) each, without a time. colours, values, look: as of `dots`."""
        look |= {"colors": _rgbs(colours), "draw_order": order}
        shape = rr.LineStrips2D.from_fields(strips=_strips(lines), **look)
        self.static(path, shape, *_any_values(values))

    def over_time(self, path: PathParts, time_ns: IntArray, columns: Iterable[Any]) -> None:
        """Log one row for each time, on the timelines CLOCKS."""
        stamps = np.asarray(time_ns, np.int64).astype("datetime64[ns]")
        times = [rr.TimeColumn(clock, timestamp=stamps) for clock in CLOCKS]
        self._stream.send_columns(entity(path), times, columns)


def entity(path: PathParts) -> str:
    """The entity path of the parts, escaped; an empty part becomes "(no name)"."""
    return rr.new_entity_path([part or "(no name)" for part in path])


def write_recording(
    path: Path, recording_id: str, fill: Callable[[Recording], rrb.Blueprint]
) -> None:
    """Write a recording atomically; rerun's warnings are raised as errors.

    `fill` logs its contents and returns the blueprint. The recording is built in memory, since
    rerun's file writer hangs when the disk is full.
    """

    def save(temporary: Path) -> None:
        stream = rr.RecordingStream(
            APPLICATION_ID,
            recording_id=recording_id,
            send_properties=False,
            batcher_config=rr.ChunkBatcherConfig.NEVER(),
        )
        try:
            blueprint = fill(Recording(stream))
            memory = stream.memory_recording()
            _send_blueprint(stream, blueprint)
            temporary.write_bytes(memory.drain_as_bytes())
        finally:
            stream.disconnect()

    with _strict():
        try:
            write_atomically(path, save)
        finally:
            # Frees the threads and buffers of disconnected streams, which rerun keeps.
            rerun_bindings.flush_and_cleanup_orphaned_recordings()


def _send_blueprint(stream: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
    """Make `blueprint` the recording's default, and active: a browser that opens it for the first
    time arranges the views by itself otherwise.

    Replaces `stream.send_blueprint`, which leaks a stream with two threads for every call.
    """
    native = rerun_bindings.new_blueprint(APPLICATION_ID, False, False, True)
    described = rr.RecordingStream._from_native(native)
    described.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(described)
    memory = described.memory_recording()
    rerun_bindings.send_blueprint(memory.storage, True, True, recording=stream.to_native())
    described.disconnect()


@contextmanager
def _strict() -> Iterator[None]:
    """Raise rerun's warnings as errors."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


def placed(T_parent_child: FloatArray, scale: float | None = None) -> rr.Transform3D:
    """A planar transform for everything below an entity, that may be scaled."""
    x, y, theta = T_parent_child
    turn = rr.RotationAxisAngle([0, 0, 1], radians=float(theta))
    return rr.Transform3D(translation=[x, y, 0.0], rotation=turn, scale=scale)


def _rgbs(colours: Colour | Sequence[Colour]) -> list[tuple[int, int, int]]:
    return [*map(rgb, [colours] if isinstance(colours, str) else colours)]


def _any_values(values: Mapping[str, Any]) -> list[rr.AnyValues]:
    return [rr.AnyValues(**values)] if values else []


def _strips(lines: Sequence[FloatArray]) -> Any:
    """Polylines, (k, 2) each, as one Arrow array: rerun would convert them one by one."""
    points = rr.components.Position2DBatch(np.concatenate([np.zeros((0, 2)), *lines]))
    stops = pa.array(np.cumsum([0, *map(len, lines)]), pa.int32())
    kind = rr.components.LineStrip2DBatch([]).as_arrow_array().type
    return pa.ListArray.from_arrays(stops, points.as_arrow_array(), type=kind)


def markdown(text: str) -> rr.TextDocument:
    """A Markdown page."""
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def map_view(
    roots: Sequence[str], name: str, low: FloatArray, high: FloatArray, overrides: Any = None
) -> rrb.Spatial2DView:
    """A 2D view of everything below `/root` for each root, which is mirrored by UP. low, high:
    corners of its bounds [m]."""
    return rrb.Spatial2DView(
        origin="/",
        contents=[f"/{root}/**" for root in roots],
        name=name,
        background=rgb(DARK.paper),
        # The view's y points down, the map's up.
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[-high[1], -low[1]]),
        overrides=overrides or {},
    )


def blueprint(root: rrb.Container, time: rrb.TimePanel) -> rrb.Blueprint:
    """A blueprint with the viewer's own panels closed."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_layout=False,
        auto_views=False,
    )


TITLE_LETTERS = 150
"""Letters across a view of typical width."""


def write_cards(recording: Recording, root: str, cells: list[Cell], titles: Sequence[str]) -> None:
    """Write a frame for each of several cells, and its title, shortened to fit."""
    if len(cells) < 2:
        return
    frames = [outline(cell.low, cell.high) for cell in cells]
    recording.lines((root, "frames"), frames, Order.CARD, DARK["card"], radii=HAIR)
    width, height = np.ptp(corners_of(cells), axis=0)
    letters_per_m = TITLE_LETTERS / max(width, ASPECT * height)
    tops = [((cell.low[0] + cell.high[0]) / 2, cell.high[1]) for cell in cells]
    rooms = [max(int((cell.high - cell.low)[0] * letters_per_m), 1) for cell in cells]
    shown = [short(title, room) for title, room in zip(titles, rooms, strict=True)]
    recording.words((root, "titles"), tops, shown, DARK.ink)


def write_corridors(
    recording: Recording,
    path: PathParts,
    graph: Graph,
    lines: Mapping[int, FloatArray],
    *,
    colours: Colour | Sequence[Colour],
    pens: float | Sequence[float],
    more: Mapping[str, Any] = NOTHING,
) -> None:
    """Write corridors with their attributes and `more`; no entity without any. lines: of each its
    polyline (k, 2), by its number; pens: width of all lines or of each [m]."""
    if not lines:
        return
    edges = np.array([*lines])
    ends = zip(graph.source[edges].tolist(), graph.target[edges].tolist(), strict=True)
    values = {
        "corridor": edges,
        "between": [f"{u} - {v}" for u, v in ends],
        "length_m": graph.length[edges],
        "length_sigma_m": graph.length_sigma[edges],
        "traversals": graph.traversals[edges],
    }
    shown = [*lines.values()]
    recording.lines(
        path, shown, Order.CORRIDOR, colours, {**values, **more}, radii=np.divide(pens, 2)
    )


def write_junctions(
    recording: Recording,
    path: PathParts,
    graph: Graph,
    rows: IntArray,
    *,
    colours: Colour | Sequence[Colour],
    sizes: float | FloatArray,
    more: Mapping[str, Any] = NOTHING,
    numbered: bool = False,
) -> None:
    """Write vertices with their attributes and `more`; no entity without any. sizes: of all or of
    each [m]; numbered: show their numbers, not only of the one pointed at."""
    if not len(rows):
        return
    values = {
        "vertex": rows,
        "kind": [graph.kind[v] for v in rows.tolist()],
        "branches": graph.branches.counts[rows],
    }
    recording.dots(
        path,
        graph.xy[rows],
        Order.JUNCTION,
        colours,
        {**values, **more},
        radii=sizes / 2,
        labels=[*map(str, rows.tolist())],
        show_labels=numbered,
    )


def write_branches(
    recording: Recording,
    path: PathParts,
    graph: Graph,
    chosen: BoolArray,
    *,
    colour: Colour,
    pen: float,
) -> None:
    """Write an arrow along each of the chosen branches (total branches,); no entity without any.
    pen: width of a corridor's line [m]."""
    if chosen.any():
        origins, vectors = branch_arrows(graph, chosen, pen)
        arrows = rr.Arrows2D(
            origins=origins,
            vectors=vectors,
            radii=THIN * pen,
            draw_order=Order.UNEXPLORED,
            colors=rgb(colour),
        )
        recording.static(path, arrows)


MOST_PIXELS = 8192
"""Largest image side that every graphics card takes; larger grids are reduced."""


def write_grid(recording: Recording, path: PathParts, grid: Grid) -> None:
    """Write a grid as occupied, free and unknown cells: as an image with a transform, since rerun's
    `GridMap` is not drawn in 2D views."""
    shade = np.full(grid.free.shape, 2, np.uint8)
    shade[grid.unknown] = 0
    shade[grid.free] = 1
    step = -(-max(shade.shape) // MOST_PIXELS)
    for axis in (0, 1):
        # A reduced cell is occupied if any of its cells is.
        starts = np.arange(0, shade.shape[axis], step)
        shade = np.maximum.reduceat(shade, starts, axis=axis)
    picture = Image.fromarray(shade)
    picture.putpalette([*rgb(DARK.paper), *rgb(DARK["unlit"]), *rgb(DARK["wall"])])
    png = BytesIO()
    picture.convert("RGB").save(png, "PNG")
    recording.static(
        path,
        placed(np.array(grid.origin), grid.resolution_m * step),
        rr.EncodedImage(contents=png.getvalue(), media_type="image/png", draw_order=Order.GRID),
    )
