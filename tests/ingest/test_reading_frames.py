"""Detections in frames of sensors, joined to the odometry's by fixed transforms of the log."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from topobatch.ingest.reading import ReadSettings, read_run
from topobatch.topology.errors import LogError
from topobatch.topology.se2 import wrap

LEVEL = Rotation.from_euler("z", 40, degrees=True)
UPSIDE_DOWN = Rotation.from_euler("zx", [-30, 180], degrees=True)
OPTICAL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # z ahead, x right, y down
TILTED = Rotation.from_euler("zyx", [20, 35, 5], degrees=True)
XYZ = np.array([0.3, -0.2, 1.1])


def mounted(message, turn, xyz, frame):
    """A detection as a sensor says it that is mounted so on what it was given in."""
    poses = []
    for pose in message.poses:
        at = turn.inv().apply(np.array(pose[:3]) - xyz)
        quaternion = (turn.inv() * Rotation.from_quat(pose[3:])).as_quat()
        poses.append((*at.tolist(), *quaternion.tolist()))
    return replace(message, frame=frame, poses=tuple(poses))


def transform(logs, parent, child, turn=LEVEL, xyz=XYZ, *, k=0, topic="/tf_static"):
    pose = (*xyz.tolist(), *turn.as_quat().tolist())
    log_ns = logs.START_NS + 1000 * k
    return logs.Message(topic, logs.TF, log_ns, log_ns, parent, child, (pose,))


@pytest.fixture
def drive(logs):
    """Odometry to base_footprint, and detections in base_link."""
    messages = [
        replace(m, child="base_footprint") if m.topic == "/odom" else m for m in logs.drive()
    ]
    return (
        [m for m in messages if m.topic == "/odom"],
        [m for m in messages if m.topic == "/junctions"],
    )


def write(logs, kind, path, messages):
    messages = sorted(messages, key=lambda m: m.log_ns)
    return logs.bag(path, messages) if kind == "bag" else getattr(logs, kind)(path, messages)


def same(found, expected):
    np.testing.assert_allclose(found.centre, expected.centre, atol=1e-9)
    np.testing.assert_allclose(wrap(found.branches.values - expected.branches.values), 0, atol=1e-9)
    assert found.time_ns.tolist() == expected.time_ns.tolist()


@pytest.mark.parametrize(
    ("kind", "turn"),
    [
        ("mcap", LEVEL),
        ("bag", TILTED),
        ("ros2_folder", UPSIDE_DOWN),
        ("mcap", UPSIDE_DOWN),
        ("mcap", OPTICAL),
    ],
)
def test_a_sensor_may_be_mounted_anyhow(logs, drive, tmp_path, kind, turn):
    odometry, seen = drive
    expected = read_run(logs.mcap(tmp_path / "plain.mcap", logs.drive())).detections
    first = Rotation.from_euler("z", -90, degrees=True)
    low = np.array([0.1, 0.0, -0.3])
    # base_link stands on base_footprint, the sensor on base_link.
    inner = [mounted(m, turn, XYZ, "sensor") for m in seen]
    outer = [mounted(m, first, low, "base_link") for m in seen]
    tf = [
        transform(logs, "base_footprint", "base_link", first, low),
        transform(logs, "base_link", "sensor", turn, XYZ, k=1),
    ]
    both = [mounted(m, turn, XYZ, "sensor") for m in outer]
    run = read_run(write(logs, kind, tmp_path / "a", [*odometry, *both, *tf]))
    assert run.warnings == ()
    same(run.detections, expected)
    # The other way round: what the odometry leads to hangs below the sensor's frame.
    up = transform(logs, "sensor", "base_footprint", turn.inv(), -turn.inv().apply(XYZ))
    run = read_run(write(logs, kind, tmp_path / "b", [*odometry, *inner, up]))
    same(run.detections, expected)


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
@pytest.mark.parametrize("many", [False, True])
def test_transforms_of_foxglove(logs, drive, tmp_path, encoding, many):

    odometry, seen = drive
    expected = read_run(logs.mcap(tmp_path / "plain.mcap", logs.drive())).detections
    turn = TILTED.as_quat().tolist()
    told = {
        "timestamp": {"sec": 5, "nsec": 0},
        "parent_frame_id": "base_footprint",
        "child_frame_id": "sensor",
        "translation": dict(zip("xyz", XYZ.tolist(), strict=True)),
        "rotation": dict(zip("xyzw", turn, strict=True)),
    }
    raw = json.dumps({"transforms": [told]} if many else told).encode()
    if encoding == "protobuf":
        fields = [
            b"\x08\x05",
            b"base_footprint",
            b"sensor",
            logs._doubles(XYZ),
            logs._doubles(turn),
        ]
        raw = b"".join(logs.field(n, value) for n, value in enumerate(fields, 1))
        raw = logs.field(1, raw) if many else raw
    folder = tmp_path / "run"
    folder.mkdir()
    logs.mcap(folder / "a.mcap", [*odometry, *(mounted(m, TILTED, XYZ, "sensor") for m in seen)])
    name = "foxglove.FrameTransforms" if many else "foxglove.FrameTransform"
    schema = name, {"json": "jsonschema"}.get(encoding, encoding), "{}"
    payloads = [(odometry[0].log_ns, raw)]
    logs.mcap_topic(folder / "b.mcap", "/transforms", encoding, schema, payloads)
    run = read_run(folder)
    assert run.warnings == ()
    same(run.detections, expected)


def test_the_base_frame_chooses_among_robots(logs, drive, tmp_path):
    odometry, seen = drive
    expected = read_run(logs.mcap(tmp_path / "plain.mcap", logs.drive())).detections
    tf = [
        replace(m, topic="/tf", type_name=logs.TF, frame=f"{robot}/odom", child=f"{robot}/base")
        for m in odometry
        for robot in ("r1", "r2")
    ]
    path = logs.mcap(tmp_path / "a.mcap", [*tf, *(replace(m, frame="r2/base") for m in seen)])
    with pytest.raises(LogError, match="expected 'r1/base'"):
        read_run(path)
    run = read_run(path, ReadSettings(base_frame="/r2/base"))
    assert (run.odometry.frame, run.odometry.child_frame) == ("r2/odom", "r2/base")
    same(run.detections, expected)
    with pytest.raises(LogError, match=r"to r3/base \(--base-frame\); it has r1/odom → r1/base"):
        read_run(path, ReadSettings(base_frame="r3/base"))
