from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections
from topobatch.topology.topomap import TopoMap
from topobatch.viz.map_recording import write_map_recording

from .readback import Readback

Make = Callable[..., TopoMap]
Drive = Callable[[TopoMap], Odometry]


def seen_on(odometry: Odometry) -> Detections:
    """A detection with three branches at every hundredth pose, a metre ahead of the robot."""
    times = odometry.time_ns[::100]
    ahead = np.tile([1.0, 0.0], (len(times), 1))
    return Detections(times, ahead, Ragged.from_rows([[0.0, 1.5, -1.5]] * len(times)))


def test_a_map_is_written_and_read_back(tmp_path: Path, make_map: Make, drive: Drive) -> None:
    topomap = make_map("run1", (2.0, 1.0, 0.5))
    path = tmp_path / "maps" / "run1.rrd"
    odometry = drive(topomap)
    write_map_recording(path, topomap, odometry=odometry, detections=seen_on(odometry))
    got = Readback(path)
    assert got.identity == ("topobatch", "run1")
    assert got.blueprints == 1
    assert {
        "/map",
        "/map/corridors",
        "/map/junctions",
        "/map/branches\\ never\\ driven",
        "/map/closures/accepted",
        "/map/closures/refused",
        "/map/odometry/recorded",
        "/map/odometry/corrected",
        "/map/detections",
        "/map/detection",
        "/map/robot",
        "/map/trail",
        "/events",
        "/drift/drift",
        "/drift/plus\\ sigma",
        "/drift/minus\\ sigma",
        "/summary",
    } == got.entities
    at = np.array(got.value("/map/junctions", "Points2D:positions"))
    assert at == pytest.approx(topomap.xy, abs=1e-5)
    assert got.value("/map/junctions", "Points2D:labels") == ["0", "1", "2", "3", "4"]
    assert got.value("/map/junctions", "passes") == [2, 2, 2, 1, 1]
    assert len(got.value("/map/corridors", "LineStrips2D:strips")) == 5
    refused, accepted = "/map/closures/refused", "/map/closures/accepted"
    assert got.value(refused, "reason") == ["2 | 1 have *other* branches"]
    assert got.value(refused, "junctions") == ["2, 1"]
    assert got.value(accepted, "junctions") == ["0"]
    told = "junction 0: visit 2 recognised as visit 1, +21.5 bits: the square closes"
    assert got.value(accepted, "closure") == [told]
    assert "# run1" in got.value("/summary", "TextDocument:text")[0]


def test_jumps_and_breaks_of_the_odometry_are_events(
    tmp_path: Path, make_map: Make, drive: Drive
) -> None:
    topomap = make_map("run1")
    odometry = replace(drive(topomap), breaks=np.array([100]))
    write_map_recording(tmp_path / "a.rrd", topomap, odometry=odometry)
    events = Readback(tmp_path / "a.rrd").rows("/events", "TextLog:text")
    assert ["the odometry breaks"] in events


def test_an_empty_map_and_a_single_vertex_are_written(
    tmp_path: Path, empty_map: TopoMap, one_vertex: TopoMap
) -> None:
    write_map_recording(tmp_path / "a.rrd", empty_map)
    write_map_recording(tmp_path / "b.rrd", one_vertex)
    assert (
        "The map is empty" in Readback(tmp_path / "a.rrd").value("/summary", "TextDocument:text")[0]
    )
    one = Readback(tmp_path / "b.rrd")
    assert one.value("/map/junctions", "kind") == ["bend"]
    assert one.blueprints == 1


def test_the_same_map_gives_the_same_recording(
    tmp_path: Path, make_map: Make, drive: Drive
) -> None:
    topomap = make_map("run1")
    for name in ("a.rrd", "b.rrd"):
        write_map_recording(tmp_path / name, topomap, odometry=drive(topomap))
    assert Readback(tmp_path / "a.rrd").content() == Readback(tmp_path / "b.rrd").content()
