"""The one place that opens and closes rerun recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings

from ..topology.arrays import FloatArray, IntArray
from ..topology.files import write_atomically
from .palette import BACKGROUND

APPLICATION_ID = "topobatch"

CLOCKS = ("message_log_time", "ros2_timestamp")
"""The timelines of a raw log that rerun reads: ours share its cursor when both are open."""

JOIN = "join"
"""The timeline of a merge: one step for each run that comes to a component."""

UP = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
"""Mirrors a map so that y points up: in the viewer's 2-D space y points down."""

HAIR = rr.Radius.ui_points(0.75)
"""The thinnest line that shows on every screen, in its points."""

PathParts = tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Slice:
    """What is logged of one entity, out of an array of many."""

    array: pa.Array

    def as_arrow_array(self) -> pa.Array:
        return self.array


def _arrays(*parts: rr.AsComponents) -> list[tuple[rr.ComponentDescriptor, pa.Array]]:
    batches = (batch for part in parts for batch in part.as_component_batches())
    return [(batch.component_descriptor(), batch.as_arrow_array()) for batch in batches]


class Recording:
    """A recording being written: paths are given in parts, so that any run name may stand in one.

    Nothing is stamped with the time of writing, and chunks end only where the recording does: the
    same results give the same content, by `rerun rrd compare --unordered`. The bytes differ: rerun
    gives rows, chunks and blueprints ids of its own, and orders the chunks of large recordings.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream

    def static(self, path: PathParts, *parts: rr.AsComponents) -> None:
        """Log what holds at all times."""
        first, *more = parts
        self._stream.log(entity(path), first, *more, static=True)

    def static_each(
        self,
        paths: Sequence[PathParts],
        counts: Sequence[int],
        *parts: rr.AsComponents,
        once: rr.AsComponents | None = None,
    ) -> None:
        """Log what holds at all times of several entities, nothing of those without things.

        `parts` hold the things of all end to end, of each entity as many as counts says: made
        together they take half the time. What a part says once holds for all; `once` says
        something once for each entity.
        """
        things, single = _arrays(*parts), _arrays(*([] if once is None else [once]))
        stops = np.cumsum([0, *counts]).tolist()
        ends, total = pairwise(stops), stops[-1]
        for k, (path, (start, stop)) in enumerate(zip(paths, ends, strict=True)):
            if stop > start:
                own = [
                    (told, array[start:stop] if len(array) == total else array)
                    for told, array in things
                ]
                own += [(told, array[k : k + 1]) for told, array in single]
                batches = [rr.DescribedComponentBatch(_Slice(part), told) for told, part in own]
                self._stream.log(entity(path), batches, static=True)

    def over_time(self, path: PathParts, time_ns: IntArray, columns: Iterable[Any]) -> None:
        """Log one row per time, on the clocks that the raw log uses."""
        stamps = np.asarray(time_ns, np.int64).astype("datetime64[ns]")
        self._send(path, [rr.TimeColumn(clock, timestamp=stamps) for clock in CLOCKS], columns)

    def over_steps(self, path: PathParts, steps: IntArray, columns: Iterable[Any]) -> None:
        """Log one row per step of a merge."""
        self._send(path, [rr.TimeColumn(JOIN, sequence=steps)], columns)

    def _send(self, path: PathParts, times: list[rr.TimeColumn], columns: Iterable[Any]) -> None:
        self._stream.send_columns(entity(path), times, columns)


def entity(path: PathParts) -> str:
    """The entity path of the given parts, escaped. An empty name cannot stand in a path."""
    return rr.new_entity_path([part or "(no name)" for part in path])


def write_recording(
    path: Path, recording_id: str, fill: Callable[[Recording], rrb.Blueprint]
) -> None:
    """Write a recording atomically; rerun's complaints are errors.

    `fill` logs what it holds and returns how to show it. The recording is made in memory: rerun's
    own writer waits for ever where the disk is full.
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
            # rerun disconnects a stream that is gone; its threads and buffers stay until asked for.
            rerun_bindings.flush_and_cleanup_orphaned_recordings()


def _send_blueprint(stream: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
    """Make `blueprint` the recording's default.

    As `stream.send_blueprint` does, but that leaves behind a stream that its own memory holds, with
    two threads, for every call.
    """
    native = rerun_bindings.new_blueprint(APPLICATION_ID, False, False, True)
    described = rr.RecordingStream._from_native(native)
    described.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(described)
    memory = described.memory_recording()
    rerun_bindings.send_blueprint(memory.storage, False, True, recording=stream.to_native())
    described.disconnect()


@contextmanager
def _strict() -> Iterator[None]:
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


def placed(T_parent_child: FloatArray) -> rr.Transform3D:
    """A motion of the plane, for everything below an entity."""
    x, y, theta = T_parent_child
    turn = rr.RotationAxisAngle([0, 0, 1], radians=float(theta))
    return rr.Transform3D(translation=[x, y, 0.0], rotation=turn)


def strips(lines: Sequence[FloatArray]) -> Any:
    """Polylines of (k, 2) points for rerun, as Arrow has them: it takes others one by one."""
    points = rr.components.Position2DBatch(np.concatenate([np.zeros((0, 2)), *lines]))
    stops = pa.array(np.cumsum([0, *map(len, lines)]), pa.int32())
    kind = rr.components.LineStrip2DBatch([]).as_arrow_array().type
    return pa.ListArray.from_arrays(stops, points.as_arrow_array(), type=kind)


def markdown(text: str) -> rr.TextDocument:
    """A page of text."""
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def map_view(
    root: str, name: str, low: FloatArray, high: FloatArray, overrides: Any = None
) -> rrb.Spatial2DView:
    """A view of everything below `/root`, which is mirrored by UP; low, high: what it spans [m]."""
    return rrb.Spatial2DView(
        origin="/",
        contents=f"/{root}/**",
        name=name,
        background=BACKGROUND,
        # The view's y points down, the map's up.
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[-high[1], -low[1]]),
        overrides=overrides or {},
    )


def blueprint(root: rrb.Container, time: rrb.TimePanel) -> rrb.Blueprint:
    """An arrangement of views, with the viewer's own panels closed at first."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_layout=False,
        auto_views=False,
    )
