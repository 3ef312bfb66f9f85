"""A run's recording with its raw log: topics below /log, what is drawn of them, views of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from topobatch.simulation import ScenarioSettings, simulate_scenario, write_run
from topobatch.topology.errors import LogError
from topobatch.viz.map_recording import write_map_recording
from topobatch.viz.raw_log import write_raw_log
from topobatch.viz.recording import APPLICATION_ID

from .readback import Readback


@pytest.fixture
def topomap(make_map):
    return make_map("monday")


@pytest.fixture
def recording(topomap, tmp_path: Path) -> Path:
    write_map_recording(tmp_path / "monday.rrd", topomap)
    return tmp_path / "monday.rrd"


def small_log(folder: Path, container: str, **more) -> Path:
    settings = ScenarioSettings(runs=1, junctions_per_run=5, odometry_hz=5, **more)
    return write_run(folder, simulate_scenario(settings).simulated[0], container)


def names_of_views(views: Path) -> list[str]:
    reader = RrdReader(views)
    (blueprint,) = reader.blueprints()
    column = "ViewBlueprint:display_name"
    batches = [c.to_record_batch() for c in reader.stream(store=blueprint)]
    return sorted(b.column(column).to_pylist()[0][0] for b in batches if column in b.schema.names)


@pytest.mark.parametrize("container", ["mcap", "ros2-mcap"])
def test_topics_lie_below_one_name_beside_the_map(
    tmp_path: Path, recording: Path, topomap, container: str
) -> None:
    log = small_log(tmp_path, container)
    write_raw_log(tmp_path / "raw.rrd", tmp_path / "views.rrd", log, recording, topomap)
    both = Readback(tmp_path / "raw.rrd")
    assert both.identity == (APPLICATION_ID, "monday") == Readback(tmp_path / "views.rrd").identity
    added = both.entities - Readback(recording).entities
    assert Readback(recording).entities < both.entities
    assert {"/log/odom", "/log/junctions"} <= added
    assert all(path.startswith("/log/") for path in added)
    assert "message_log_time" in both.timelines
    # Of several that are opened, the viewer takes the views of any.
    assert both.blueprints == 0


def test_speeds_and_echoes_are_drawn_as_the_log_has_them(
    tmp_path: Path, recording: Path, topomap
) -> None:
    log = small_log(tmp_path, "ros2-mcap", laser="none")
    write_raw_log(tmp_path / "raw.rrd", tmp_path / "views.rrd", log, recording, topomap)
    both, store = Readback(tmp_path / "raw.rrd"), get_typestore(Stores.ROS2_HUMBLE)
    turning, echoes, times = [], [], []
    with Reader(log) as reader:
        for connection, time_ns, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic == "/odom":
                turning.append(message.twist.twist.angular.z)
                times.append(time_ns)
            elif connection.topic == "/scan":
                angle = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
                seen = (message.ranges >= message.range_min) & (message.ranges < message.range_max)
                ahead = (message.ranges * np.cos(angle))[seen]
                left = (message.ranges * np.sin(angle))[seen]
                echoes.append(np.column_stack([-left, -ahead]))
    drawn = both.rows("/log/odom/turning", "Scalars:scalars")
    np.testing.assert_allclose(np.concatenate(drawn), turning)
    np.testing.assert_array_equal(both.times("/log/odom/turning", "message_log_time"), times)
    points = both.rows("/log/scan/echoes", "Points2D:positions")
    assert len(points) == len(echoes) > 10
    for row, expected in zip(points, echoes, strict=True):
        np.testing.assert_allclose(np.reshape(row, (-1, 2)), expected, atol=1e-4)
    shown = names_of_views(tmp_path / "views.rrd")
    assert {"Map", "Summary", "/odom [m/s, rad/s]", "/scan, ahead is up", "Topics"} <= set(shown)


def test_logs_that_the_viewer_does_not_read_are_refused(
    tmp_path: Path, recording: Path, topomap
) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(LogError, match="in MCAP only"):
        write_raw_log(
            tmp_path / "raw.rrd", tmp_path / "views.rrd", tmp_path / "a.bag", recording, topomap
        )
    assert not (tmp_path / "raw.rrd").exists()
