"""The logs that the simulator writes, read back by other people's readers and by our own."""

from __future__ import annotations

import hashlib
import sqlite3
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.ingest.reading import read_run
from topobatch.simulation import (
    FORMATS,
    LaserSettings,
    MotionSettings,
    RunSettings,
    Scenario,
    ScenarioSettings,
    SimulatedRun,
    make_world,
    read_truth,
    simulate_run,
    simulate_scenario,
    write_run,
    write_scenario,
)
from topobatch.simulation.lz4_frame import lz4_frame
from topobatch.simulation.messages import (
    DIGESTS,
    ODOMETRY_TYPE,
    POSES_TYPE,
    SCAN_TYPE,
    TRANSFORMS_TYPE,
    definition,
    topics_of,
)
from topobatch.topology.errors import UsageError
from topobatch.topology.se2 import wrap


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    s = ScenarioSettings(
        "maze",
        runs=2,
        overlap=0.4,
        junctions_per_run=8,
        odometry_hz=10.0,
        motion=MotionSettings(1.2, 1.4),
        seed=11,
    )
    return simulate_scenario(s)


@pytest.fixture(scope="module")
def simulated(scenario: Scenario) -> SimulatedRun:
    return scenario.simulated[0]


# --- compression -------------------------------------------------------------------------------


RANDOM = np.random.default_rng(1).bytes(70_000)


@pytest.mark.parametrize(
    "records",
    [
        [],
        [b""],
        [b"a"],
        [b"abcabcabcabc"] * 2,
        [b"abc"] * 9,
        [bytes(1000)] * 3,
        [bytes(i) for i in range(300)] * 2,
        [RANDOM, RANDOM[:700], RANDOM[:500], RANDOM[:700]],
        [RANDOM[:60_000]] * 3,
        [bytes(5 << 20), b"end"],
        [RANDOM[:749]] * 9000,
    ],
    ids=lambda records: f"{len(records)} records",
)
def test_lz4_frames_are_read_by_the_library(records: list[bytes]) -> None:
    packed = lz4_frame(records)
    assert lz4.frame.decompress(packed) == b"".join(records)
    assert len(packed) <= len(b"".join(records)) + 20


@settings(deadline=None, max_examples=100)
@given(st.lists(st.binary(min_size=20, max_size=22), max_size=9), st.integers(1, 5))
def test_lz4_frames_hold_any_bytes(records: list[bytes], times: int) -> None:
    mixed = [bytes(a & 1 for a in record) for record in records] + records
    assert lz4.frame.decompress(lz4_frame(mixed * times)) == b"".join(mixed * times)


def test_lz4_compresses_records_that_are_alike() -> None:
    assert len(lz4_frame([RANDOM[:700], b"between"] * 100)) < 2500


# --- message definitions -----------------------------------------------------------------------


def _stores() -> tuple[Any, Any]:
    """Those of ROS 1 and 2, with the transforms that rosbags does not bundle for ROS 1."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    for store in (ros1, ros2):
        if TRANSFORMS_TYPE not in store.types:
            text = "geometry_msgs/TransformStamped[] transforms"
            store.register(get_types_from_msg(text, TRANSFORMS_TYPE))
    return ros1, ros2


@pytest.mark.parametrize("type_name", [ODOMETRY_TYPE, POSES_TYPE, SCAN_TYPE, TRANSFORMS_TYPE])
def test_definitions_and_hashes_are_those_of_ros(type_name: str) -> None:
    ros1, ros2 = _stores()
    text, digest = ros1.generate_msgdef(type_name, ros_version=1)
    assert (text, digest) == (definition(type_name, "ros1"), DIGESTS["ros1", type_name])
    assert ros2.generate_msgdef(type_name, ros_version=2)[0] == definition(type_name, "ros2")
    assert ros2.hash_rihs01(type_name) == DIGESTS["ros2", type_name]


@pytest.mark.parametrize("ros", ["ros1", "ros2"])
@pytest.mark.parametrize("upside_down", [False, True])
def test_payloads_are_those_of_rosbags(ros: str, upside_down: bool) -> None:
    laser = LaserSettings(beams=50, upside_down=upside_down, mount=(0.1, 0.2, 0.3))
    run = RunSettings(motion=MotionSettings(1.2, 1.4), laser=laser)
    simulated = simulate_run(make_world("maze", 6, 2), settings=run)
    store = _stores()[0 if ros == "ros1" else 1]
    topics = topics_of(simulated, ros)
    assert [topic.name for topic in topics] == ["/odom", "/junctions", "/scan", "/tf_static"]
    for topic in topics:
        for payload in topic.payloads[::37]:
            if ros == "ros1":
                message: Any = store.deserialize_ros1(payload, topic.type_name)
                again = store.serialize_ros1(message, topic.type_name)
            else:
                message = store.deserialize_cdr(payload, topic.type_name)
                again = store.serialize_cdr(message, topic.type_name)
            assert bytes(again) == payload
    assert simulated.scans is not None
    transform = message.transforms[0].transform
    assert (transform.translation.x, transform.translation.y) == (0.1, 0.2)


# --- containers --------------------------------------------------------------------------------


def _check_with_rosbags(path: Path, simulated: SimulatedRun) -> None:
    from rosbags.highlevel import AnyReader

    odometry, seen = simulated.run.odometry, simulated.run.detections
    poses, times, stars = [], [], []
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            if connection.topic == "/odom":
                pose = message.pose.pose
                yaw = 2 * np.arctan2(pose.orientation.z, pose.orientation.w)
                poses.append((stamp, pose.position.x, pose.position.y, yaw))
                assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
            else:
                assert message.header.frame_id == "base_link"
                times.append(stamp)
                stars.append(
                    [2 * np.arctan2(p.orientation.z, p.orientation.w) for p in message.poses]
                )
    assert [p[0] for p in poses] == odometry.time_ns.tolist()
    np.testing.assert_array_equal(np.array(poses)[:, 1:3], odometry.pose[:, :2])
    np.testing.assert_allclose(wrap(np.array(poses)[:, 3] - odometry.pose[:, 2]), 0, atol=1e-6)
    assert times == seen.time_ns.tolist()
    assert [len(star) for star in stars] == seen.branches.counts.tolist()
    np.testing.assert_allclose(wrap(np.concatenate(stars) - seen.branches.values), 0, atol=1e-6)


@pytest.mark.parametrize("container", FORMATS)
def test_rosbags_reads_what_was_simulated(
    simulated: SimulatedRun, container: str, tmp_path: Path
) -> None:
    _check_with_rosbags(write_run(tmp_path, simulated, container), simulated)


@pytest.mark.parametrize("container", FORMATS)
def test_our_reader_reads_what_was_simulated(
    simulated: SimulatedRun, container: str, tmp_path: Path
) -> None:
    run = read_run(write_run(tmp_path, simulated, container))
    want = simulated.run
    assert (run.name, run.warnings) == (want.name, ())
    np.testing.assert_array_equal(run.odometry.time_ns, want.odometry.time_ns)
    np.testing.assert_allclose(run.odometry.pose, want.odometry.pose, atol=1e-6)
    np.testing.assert_array_equal(run.odometry.breaks, want.odometry.breaks)
    np.testing.assert_array_equal(run.detections.time_ns, want.detections.time_ns)
    np.testing.assert_allclose(run.detections.centre, want.detections.centre, atol=1e-9)
    np.testing.assert_allclose(
        wrap(run.detections.branches.values - want.detections.branches.values), 0, atol=1e-6
    )


def test_mcap_checksums_indexes_and_summary_are_right(
    simulated: SimulatedRun, tmp_path: Path
) -> None:
    from mcap.reader import NonSeekingReader, make_reader

    path = write_run(tmp_path, simulated)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        indexed = [message.data for _, _, message in reader.iter_messages()]
    with path.open("rb") as file:
        streamed = NonSeekingReader(file, validate_crcs=True)
        assert [message.data for _, _, message in streamed.iter_messages()] == indexed
    counts = summary.statistics.channel_message_counts
    assert counts == {1: len(simulated.run.odometry), 2: len(simulated.run.detections)}
    assert summary.statistics.message_count == len(indexed)
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count >= 1


def test_databases_are_sound_and_timed(simulated: SimulatedRun, tmp_path: Path) -> None:
    folder = write_run(tmp_path, simulated, "db3")
    database = sqlite3.connect(folder / f"{folder.name}_0.db3")
    try:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        count, least, most = database.execute(
            "SELECT count(*), min(timestamp), max(timestamp) FROM messages"
        ).fetchone()
    finally:
        database.close()
    text = (folder / "metadata.yaml").read_text()
    assert f"message_count: {count}\n" in text
    assert f"nanoseconds_since_epoch: {least}\n" in text
    assert f"nanoseconds: {most - least}\n" in text


# --- scenarios ---------------------------------------------------------------------------------


def _digests(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_formats_are_dealt_out_and_files_repeat(scenario: Scenario, tmp_path: Path) -> None:
    told: list[Path] = []
    first = write_scenario(scenario, tmp_path / "a", ("bag", "db3"), told.append)
    write_scenario(scenario, tmp_path / "b", ("bag", "db3"))
    write_scenario(scenario, tmp_path / "b", ("bag", "db3"))  # over what is there
    assert [path.name for path in first] == ["run1.bag", "run2"]
    assert told == first
    assert _digests(tmp_path / "a") == _digests(tmp_path / "b")
    assert set(_digests(tmp_path / "a")) == {
        *("run1.bag", "truth.json"),
        *("run2/metadata.yaml", "run2/run2_0.db3"),
    }
    assert set(read_truth(tmp_path / "a" / "truth.json").runs) == {"run1", "run2"}


@pytest.mark.parametrize("formats", [(), ("rar",), ("mcap", "zip")])
def test_unknown_formats_are_refused(
    scenario: Scenario, formats: tuple[str, ...], tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="choose one of mcap"):
        write_scenario(scenario, tmp_path / "out", formats)
    assert not (tmp_path / "out").exists()
    with pytest.raises(UsageError):
        write_run(tmp_path, scenario.simulated[0], "rar")
