"""The logs that the simulator writes, read back by other people's readers and by our own."""

from __future__ import annotations

import hashlib
import json
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from topobatch.simulation.scenario import Scenario, SimulatedRun, simulate_run, simulate_scenario
from topobatch.simulation.settings import (
    LaserSettings,
    MotionSettings,
    RunSettings,
    ScenarioSettings,
)
from topobatch.simulation.worlds import make_world
from topobatch.simulation.writing import (
    FORMATS,
    TOPICS,
    messages_of,
    topics_of,
    typestore,
    write_run,
    write_scenario,
)
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


# --- messages ----------------------------------------------------------------------------------


@pytest.mark.parametrize("ros", ["ros1", "ros2"])
@pytest.mark.parametrize("upside_down", [False, True])
def test_payloads_are_those_of_rosbags(ros: str, upside_down: bool) -> None:
    laser = LaserSettings(beams=50, upside_down=upside_down, mount=(0.1, 0.2, 0.3))
    run = RunSettings(motion=MotionSettings(1.2, 1.4), laser=laser)
    simulated = simulate_run(make_world("maze", 6, 2), settings=run)
    store = typestore(ros)
    messages = messages_of(simulated, ros)
    log_ns = [log for log, _, _ in messages]
    assert log_ns == sorted(log_ns)
    assert {topic for _, topic, _ in messages} == set(topics_of(simulated)) == set(TOPICS)
    read, write = (
        (store.deserialize_ros1, store.serialize_ros1)
        if ros == "ros1"
        else (store.deserialize_cdr, store.serialize_cdr)
    )
    (mount,) = (read(raw, TOPICS[topic]) for _, topic, raw in messages if topic == "/tf_static")
    for _, topic, payload in messages[::37]:
        assert bytes(write(read(payload, TOPICS[topic]), TOPICS[topic])) == payload
    assert simulated.scans is not None
    transform = mount.transforms[0].transform
    assert (transform.translation.x, transform.translation.y) == (0.1, 0.2)


# --- containers --------------------------------------------------------------------------------


def _check_with_rosbags(path: Path, simulated: SimulatedRun) -> None:
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
def test_a_full_disk_is_told_with_the_log(
    simulated: SimulatedRun, container: str, tmp_path: Path
) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(OSError, match=rf"{tmp_path}/run1[.\w]*'$"):
            write_run(tmp_path, simulated, container)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


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
        *("run2/metadata.yaml", "run2/run2.db3"),
    }
    truth = json.loads((tmp_path / "a" / "truth.json").read_text())
    assert set(truth["runs"]) == {"run1", "run2"}
    write_run(tmp_path / "a", scenario.simulated[1], "bag")
    assert {p.name for p in Path(tmp_path / "a").iterdir()} == {
        "run1.bag",
        "run2.bag",
        "truth.json",
    }
