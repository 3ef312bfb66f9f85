"""What a laser saw, under the map."""

from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Scanned, ScanPasses
from topobatch.topology.se2 import apply
from topobatch.topology.topomap import TopoMap
from topobatch.topology.views import CELL_M, SIDE, WALL, Views
from topobatch.viz.map_recording import write_map_recording
from topobatch.viz.palette import DARK, rgb

from .readback import Readback

Make = Callable[..., TopoMap]
Drive = Callable[[TopoMap], Odometry]

LEFT = [(0.1, 1.1), (0.5, 1.1)]
"""Middles of the cells of a wall on the robot's left, in every view."""


def seen_walls(topomap: TopoMap, odometry: Odometry) -> TopoMap:
    """The map with a view at every tenth pose, each with the wall on the left."""
    pose = odometry.pose[::10]
    cells = np.zeros((len(pose), SIDE, SIDE), np.uint8)
    column, row = (np.array(LEFT) / CELL_M + SIDE / 2).astype(int).T
    cells[:, row, column] = WALL
    return replace(topomap, views=Views(odometry.time_ns[::10], pose, cells))


def scanned(topomap: TopoMap) -> Scanned:
    """A junction for each but the last of the map's observations."""
    time_ns = topomap.observation_time_ns[:-1]
    p = len(time_ns)
    branches = Ragged.from_rows([[0.0, 1.5, 3.0]] * p)
    passes = ScanPasses(
        time_ns=time_ns,
        start_ns=time_ns,
        end_ns=time_ns,
        centre=np.zeros((p, 2)),
        branches=branches,
        confidence=np.linspace(0.4, 1.0, p),
        windows=np.full(p, 3),
        clearance_m=np.ones(p),
        shared_m=np.zeros(p),
    )
    return Scanned(passes, topomap.noise)


def recorded(path: Path, topomap: TopoMap, odometry: Odometry) -> tuple[Scanned, Readback]:
    """What was seen, and the recording of it."""
    found = scanned(topomap)
    write_map_recording(path, topomap, odometry=odometry, scanned=found)
    return found, Readback(path)


def test_walls_lie_where_the_views_of_the_map_are(
    tmp_path: Path, make_map: Make, drive: Drive
) -> None:
    topomap = make_map("run1", (2.0, 1.0, 0.5))
    odometry = drive(topomap)
    topomap = seen_walls(topomap, odometry)
    _, got = recorded(tmp_path / "a.rrd", topomap, odometry)
    (png,) = got.rows("/map/scans/walls", "EncodedImage:blob")
    shades = np.asarray(Image.open(BytesIO(bytes(png[0]))))
    row, column = np.nonzero((shades == rgb(DARK["wall"])).all(axis=-1))
    (corner,) = got.value("/map/scans/walls", "Transform3D:translation")
    (scale,) = got.value("/map/scans/walls", "Transform3D:scale")
    walls = corner[:2] + (np.stack([column, row], axis=-1) + 0.5) * scale[0]
    pose = topomap.views.pose
    wanted = apply(np.repeat(pose, 2, axis=0), np.tile(LEFT, (len(pose), 1)))
    off = np.hypot(*(walls[:, None] - wanted).transpose(2, 0, 1))
    assert off.min(axis=1).max() < 0.25
    assert off.min(axis=0).max() < 0.25


def test_junctions_tell_their_confidence(tmp_path: Path, make_map: Make, drive: Drive) -> None:
    topomap = make_map("run1", (2.0, 1.0, 0.5))
    topomap = replace(topomap, confidence=np.linspace(0.5, 1.0, len(topomap)))
    odometry = drive(topomap)
    found, got = recorded(tmp_path / "a.rrd", topomap, odometry)
    sure = found.passes.confidence
    assert got.value("/map/scans/junctions", "confidence") == pytest.approx(sure)
    assert got.value("/map/scans/junctions", "branches") == [3] * len(sure)
    at = np.array(got.value("/map/scans/junctions", "Points2D:positions"))
    passed = odometry.at(found.passes.time_ns)[:, :2]
    assert np.hypot(*(at - passed).T).max() < 2.5
    assert got.value("/map/junctions", "confidence") == pytest.approx(topomap.confidence)
    (summary,) = got.value("/summary", "TextDocument:text")
    assert "walls that the laser saw" in summary


def test_without_scans_nothing_is_drawn(tmp_path: Path, make_map: Make, drive: Drive) -> None:
    topomap = make_map("run1")
    write_map_recording(tmp_path / "a.rrd", topomap, odometry=drive(topomap))
    assert not [entity for entity in Readback(tmp_path / "a.rrd").entities if "scans" in entity]
