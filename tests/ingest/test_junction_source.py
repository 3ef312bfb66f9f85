"""Where junctions come from, and runs read from scans, clouds and grids."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from topobatch.ingest.inspection import as_read
from topobatch.ingest.junction_source import junction_source
from topobatch.ingest.logs.grids import GridLog
from topobatch.ingest.logs.messages import Channel
from topobatch.ingest.logs.recording import recording_at
from topobatch.ingest.mapping import build_map
from topobatch.ingest.mounting import known_mounting, mounting
from topobatch.ingest.read_settings import ReadSettings
from topobatch.ingest.reading import inspect_log, read_log, read_run
from topobatch.simulation.scenario import Scenario, simulate_scenario
from topobatch.simulation.settings import LaserSettings, MotionSettings, ScenarioSettings
from topobatch.simulation.writing import write_run
from topobatch.topology.errors import LogError, UsageError
from topobatch.topology.run import Run
from topobatch.topology.se2 import apply, fit_rigid

ODOM = ("/odom", "nav_msgs/msg/Odometry")
SEEN = ("/junctions", "geometry_msgs/msg/PoseArray")
SCAN = ("/scan", "sensor_msgs/msg/LaserScan")
POINTS = ("/points", "sensor_msgs/msg/PointCloud2")
MAP = ("/map", "nav_msgs/msg/OccupancyGrid")


def counts(*topics: tuple[str, str]) -> dict[Channel, int]:
    return {Channel(topic, kind, "cdr"): 5 + k for k, (topic, kind) in enumerate(topics)}


def chosen(*topics: tuple[str, str], **settings: Any) -> tuple[str, str]:
    source = junction_source(counts(*topics), ReadSettings(**settings), "log")
    return source.way, source.choice.topic


def test_the_first_way_that_a_log_has_something_for() -> None:
    assert chosen(ODOM, SEEN, SCAN, POINTS, MAP) == ("topic", "/junctions")
    assert chosen(ODOM, SCAN, POINTS, MAP) == ("scan", "/scan")
    assert chosen(ODOM, POINTS, MAP) == ("cloud", "/points")
    assert chosen(MAP) == ("grid", "/map")
    source = junction_source(counts(ODOM, SEEN, SCAN), ReadSettings(), "log")
    assert source.passed_over == ("/scan",)


def test_one_sentence_says_what_there_is_and_what_each_way_needs() -> None:
    with pytest.raises(LogError) as refused:
        chosen(ODOM, ("/image", "sensor_msgs/msg/Image"))
    for word in ("PoseArray", "LaserScan", "PointCloud2", "OccupancyGrid", "/image", "/odom"):
        assert word in str(refused.value)


# --- whole logs --------------------------------------------------------------------------------


def scenario(**changes: Any) -> Scenario:
    settings = ScenarioSettings(
        "office",
        runs=1,
        junctions_per_run=8,
        drift="low",
        faults="none",
        motion=MotionSettings(1.3, 1.5),
        odometry_hz=10.0,
        laser=LaserSettings(beams=120, rate_hz=4.0, door_share=0.0, people_per_100_m=0.0),
        seed=3,
    )
    return simulate_scenario(replace(settings, **changes))


DETECTIONS_ALONE = ReadSettings(junctions_from="topic")


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with detections and scans."""
    return write_run(tmp_path_factory.mktemp("both"), scenario().simulated[0])


@pytest.fixture(scope="module")
def straight(both: Path) -> Run:
    """Its run from the scans."""
    return read_run(both, ReadSettings(junctions_from="scan"))


def test_with_detections_and_scans_the_detections_win(both: Path) -> None:
    run = read_run(both, DETECTIONS_ALONE)
    assert len(run.detections) > 0
    assert run.scanned is None
    assert len(run.views) == 0
    assert run.source["junctions"]["passed_over"] == ["/scan"]
    uses = {topic.topic: (topic.use, topic.why) for topic in inspect_log(both).topics}
    assert uses["/junctions"][0] == "junctions"
    told = "shows the walls around places; --junctions-from scan finds junctions in it"
    assert uses["/scan"] == ("scans", told)
    uses = {t.topic: t.why for t in inspect_log(both, DETECTIONS_ALONE).topics}
    assert uses["/scan"] == "not used; --junctions-from scan finds junctions in it"


def test_the_junctions_are_of_the_detector_and_the_views_of_the_laser(
    both: Path, straight: Run
) -> None:
    run = read_run(both)
    assert run.source["views"] == {
        "from": "scan",
        "topic": "/scan",
        "type": "sensor_msgs/msg/LaserScan",
    }
    plain, topomap = build_map(read_run(both, DETECTIONS_ALONE)), build_map(run)
    assert np.array_equal(topomap.xy, plain.xy)
    assert len(topomap.views) > 5
    # They lie where the laser's own map has them.
    of_scans = build_map(straight)
    assert straight.scanned is not None
    _, here, there = np.intersect1d(
        topomap.views.time_ns, of_scans.views.time_ns, return_indices=True
    )
    one, two = topomap.views.pose[here, :2], of_scans.views.pose[there, :2]
    apart = one - apply(fit_rigid(one, two), two)
    assert np.hypot(*apart.T).max() < 1.0


def test_scans_become_a_map(straight: Run) -> None:
    run = straight
    assert run.scanned is not None
    assert len(run.detections) == 0
    told = run.source["junctions"]
    assert (told["from"], told["topic"], told["passed_over"]) == ("scan", "/scan", ["/junctions"])
    assert told["covered"] > 0.9
    assert run.warnings == ()
    topomap = build_map(run)
    assert len(topomap) >= 2
    assert topomap.info["source"]["junctions"]["messages"] == told["scans"]


@pytest.mark.parametrize("upside_down", [False, True])
def test_the_mounting_is_found_in_the_log(tmp_path: Path, upside_down: bool) -> None:
    laser = LaserSettings(
        beams=90, rate_hz=4.0, mount=(0.2, -0.1, 0.4), upside_down=upside_down, noise_m=0.0
    )
    simulated = scenario(junctions_per_run=5, laser=laser).simulated[0]
    recording = recording_at(write_run(tmp_path, simulated))
    where = known_mounting(recording, {"laser"}, simulated.run.odometry.child_frame)
    assert where.knows({"laser"})
    found, told = mounting(where, {"laser"}, ReadSettings())
    assert told == []
    mount = found.of("laser")
    assert mount is not None
    np.testing.assert_allclose(mount[:2], (0.2, -0.1))
    turn = [np.cos(0.2), np.sin(0.2), 0, 0] if upside_down else [0, 0, np.sin(0.2), np.cos(0.2)]
    np.testing.assert_allclose(mount[3:], turn, atol=1e-6)


def test_a_mounting_that_nobody_tells_is_assumed_and_said(
    sensors: ModuleType, tmp_path: Path
) -> None:
    log = recording_at(
        sensors.mcap(
            tmp_path / "x.mcap", [("/scan", sensors.SCAN, 1, sensors.scan([1, 2, 3, 4, 5]))]
        )
    )
    where = known_mounting(log, {"laser"}, "base_link")
    found, (told,) = mounting(where, {"laser"}, ReadSettings(), lambda _: None)
    assert "'laser'" in told
    assert "--laser-pose" in told
    assert found.of("laser") is not None
    named, told_named = mounting(where, {"laser"}, ReadSettings(laser_pose=(1.0, 2.0, 0.5)))
    assert told_named == []
    mount = named.of("anything")
    assert mount is not None
    np.testing.assert_allclose(mount[[0, 1, 5]], (1.0, 2.0, np.sin(0.25)))
    alone, (told_alone,) = mounting(known_mounting(log, {"laser"}, None), {"laser"}, ReadSettings())
    assert "no odometry to tell: if it is upside down, the map is a mirror image" in told_alone
    assert alone.of("laser") is not None
    with pytest.raises(UsageError, match="--laser-pose"):
        ReadSettings(laser_pose=(0.0, float("nan"), 0.0))


@pytest.mark.parametrize("placed", [False, True])
def test_a_laser_upside_down_is_found_to_be(
    both: Path, straight: Run, sensors: ModuleType, tmp_path: Path, placed: bool
) -> None:
    """Without its transform, or with one that says that it is upright."""

    def mirrored(topic: str, kind: str, log_ns: int, raw: bytes) -> list[Any]:
        if topic == "/tf_static" and not placed:
            return []
        if topic == "/scan":
            scan = sensors.ROS2.deserialize_cdr(raw, kind)
            scan.ranges = scan.ranges[::-1].copy()
            raw = sensors.packed(scan, kind)
        return [(topic, kind, log_ns, raw)]

    run = read_run(
        rewritten(both, tmp_path / "x.mcap", sensors, mirrored), ReadSettings(junctions_from="scan")
    )
    *assumed, told = run.warnings
    assert len(assumed) == (0 if placed else 1)
    assert "against the odometry" in told
    assert "upside down" in told
    assert run.source["junctions"]["drift_after_m"] < 0.2
    assert run.scanned is not None
    assert straight.scanned is not None
    assert abs(len(run.scanned.passes) - len(straight.scanned.passes)) <= 2


def test_scans_that_are_stamped_late_are_found_to_be(
    both: Path, straight: Run, sensors: ModuleType, tmp_path: Path
) -> None:
    def late(topic: str, kind: str, log_ns: int, raw: bytes) -> list[Any]:
        if topic == "/scan":
            scan = sensors.ROS2.deserialize_cdr(raw, kind)
            stamp_ns = scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec + 400_000_000
            scan.header = sensors.header(stamp_ns, scan.header.frame_id)
            raw = sensors.packed(scan, kind)
        return [(topic, kind, log_ns, raw)]

    settings = ReadSettings(junctions_from="scan")
    run = read_run(rewritten(both, tmp_path / "x.mcap", sensors, late), settings)
    (told,) = run.warnings
    found = re.fullmatch(r".* does, (.*) s late: the odometry was taken by the scans' clock", told)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.4, abs=0.05)
    assert run.scanned is not None
    assert straight.scanned is not None
    ours, true = run.scanned.passes, straight.scanned.passes
    assert abs(len(ours) - len(true)) <= 2
    assert run.source["junctions"]["drift_after_m"] < 0.2


def test_a_log_with_a_grid_alone(sensors: ModuleType, tmp_path: Path) -> None:
    cells = np.full((60, 60), 100)
    cells[28:34, 5:55] = cells[5:55, 28:34] = 0
    rows = [
        ("/map", sensors.GRID, sensors.START_NS, sensors.grid(np.full((3, 3), -1))),
        ("/map", sensors.GRID, sensors.START_NS + 1, sensors.grid(cells, 0.2, (1.0, 2.0, 0.5))),
    ]
    broken = ("/map", sensors.GRID, sensors.START_NS + 2, b"broken")
    with pytest.raises(LogError, match="no grid can be read from /map"):
        read_log(sensors.mcap(tmp_path / "broken.mcap", [*rows, broken]))
    found = read_log(sensors.mcap(tmp_path / "grid.mcap", rows))
    assert isinstance(found, GridLog)
    np.testing.assert_array_equal(found.grid.free, cells == 0)
    assert found.grid.resolution_m == pytest.approx(0.2)
    np.testing.assert_allclose(found.grid.origin, (1.0, 2.0, 0.5))
    assert found.warnings == ()
    with pytest.raises(LogError, match="no run"):
        read_run(tmp_path / "grid.mcap")


def rewritten(both: Path, out: Path, sensors: ModuleType, change: Any) -> Path:
    """The messages of a log, changed one by one: topic, type, log time and payload to several."""
    from mcap.reader import make_reader

    rows = []
    with both.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=True):
            assert schema is not None
            rows += change(channel.topic, schema.name, message.log_time, message.data)
    return Path(sensors.mcap(out, rows))


def test_clouds_become_a_map(both: Path, sensors: ModuleType, tmp_path: Path) -> None:
    def as_cloud(topic: str, kind: str, log_ns: int, raw: bytes) -> list[Any]:
        if topic == "/junctions":
            return []
        if topic != "/scan":
            return [(topic, kind, log_ns, raw)]
        scan = sensors.ROS2.deserialize_cdr(raw, kind)
        stamp_ns = scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec
        angle = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        seen = np.isfinite(scan.ranges)
        xy = scan.ranges[seen, None] * np.column_stack([np.cos(angle), np.sin(angle)])[seen]
        xyz = np.hstack([xy, np.zeros((len(xy), 1))])
        return [("/velo", sensors.CLOUD, log_ns, sensors.cloud(xyz, stamp_ns=stamp_ns))]

    run = read_run(rewritten(both, tmp_path / "cloud.mcap", sensors, as_cloud))
    assert run.source["junctions"]["from"] == "cloud"
    assert run.source["junctions"]["topic"] == "/velo"
    assert run.scanned is not None
    assert len(run.scanned.passes) > 5
    assert run.warnings == ()


def scans_alone(topic: str, *rest: Any) -> list[Any]:
    return [(topic, *rest)] if topic in ("/scan", "/tf_static") else []


def test_scans_without_odometry(both: Path, sensors: ModuleType, tmp_path: Path) -> None:
    log = rewritten(both, tmp_path / "scans.mcap", sensors, scans_alone)
    assert inspect_log(log).problems == ()
    run = read_run(log)
    assert run.scanned is not None
    assert "odometry" not in run.source
    assert any("no odometry" in warning for warning in run.warnings)
    way = read_run(both).odometry.step_m.sum()
    assert run.odometry.step_m.sum() == pytest.approx(way, rel=0.1)


def test_an_odometry_that_never_moves_is_left_out(
    both: Path, sensors: ModuleType, tmp_path: Path
) -> None:
    def stands(topic: str, kind: str, log_ns: int, raw: bytes) -> list[Any]:
        if topic != "/odom":
            return scans_alone(topic, kind, log_ns, raw)
        odometry = sensors.ROS2.deserialize_cdr(raw, kind)
        odometry.pose.pose.position.x = odometry.pose.pose.position.y = 0.0
        return [(topic, kind, log_ns, sensors.packed(odometry, kind))]

    log = rewritten(both, tmp_path / "stands.mcap", sensors, stands)
    run = read_run(log)
    assert run.warnings[0] == (
        "/odom: never moves, but the scans do; left out: each scan was matched to the one before"
    )
    alone = read_run(rewritten(both, tmp_path / "alone.mcap", sensors, scans_alone))
    assert run.odometry.step_m.sum() == pytest.approx(alone.odometry.step_m.sum(), rel=0.01)
    uses = {topic.topic: topic.why for topic in as_read(inspect_log(log), run.source).topics}
    assert uses["/odom"] == "not used: never moves, but the scans do"
