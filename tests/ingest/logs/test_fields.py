"""--junction-fields: units, and paths that lead nowhere, found out before a log is read whole."""

from __future__ import annotations

import json

import numpy as np
import pytest

from topobatch.ingest.reading import ReadSettings, inspect_log, read_run
from topobatch.topology.errors import UsageError

SEEN = """\
std_msgs/Header header
geometry_msgs/PoseWithCovariance at
geometry_msgs/Point[] corners
float64[] ways
string note
builtin_interfaces/Time[] times
float32 width
"""


def written(logs, folder, angles, *, encoding="cdr", ros1=False, first=None, last=None, **options):
    """A drive whose detections are of a type of our own; `angles` of all but perhaps the first and
    the last. options: of both files' writers."""
    from rosbags.typesys import get_types_from_msg

    store = logs.new_store(ros1)
    name = "a/msg/Seen"
    text = SEEN.replace("builtin_interfaces/Time", "time") if ros1 else SEEN
    store.register(get_types_from_msg(text, name))
    definition, _ = store.generate_msgdef(name, ros_version=1 if ros1 else 2)
    folder.mkdir(exist_ok=True)
    drive = logs.drive()
    logs.mcap(folder / "a.mcap", [m for m in drive if m.topic == "/odom"], **options)
    seen = [m for m in drive if m.topic == "/junctions"]
    kinds = {"cdr": "ros2msg", "ros1": "ros1msg", "json": "jsonschema"}
    encoding = "ros1" if ros1 else encoding
    text = "{}" if encoding == "json" else definition
    payloads = []
    for k, message in enumerate(seen):
        other = {0: first, len(seen) - 1: last}.get(k)
        ways = angles if other is None else other
        raw = payload(logs, store, name, message=message, ways=ways, encoding=encoding)
        payloads.append((message.log_ns, raw))
    logs.mcap_topic(
        folder / "b.mcap",
        "/seen",
        encoding,
        ("a/Seen" if ros1 else name, kinds[encoding], text),
        payloads,
        chunk_size=500,
        **options,
    )
    return folder


def payload(logs, store, name, *, message, ways, encoding):
    if encoding == "json":
        stamp = {
            "sec": message.stamp_ns // 10**9,
            "nsec": message.stamp_ns % 10**9,
            "nanoseconds": message.stamp_ns,
        }
        header = {"frame_id": "base_link", "stamp": stamp}
        at = {"pose": {"position": {"x": 0.5, "y": 0.25}}}
        return json.dumps({"header": header, "at": at, "ways": ways}).encode()
    t, ros1 = store.types, encoding == "ros1"
    pose = logs.ros_object(message, store, ros1)
    covariance = t["geometry_msgs/msg/PoseWithCovariance"](
        pose=pose.poses[0], covariance=np.zeros(36)
    )
    value = t[name](
        header=pose.header,
        at=covariance,
        corners=[],
        ways=np.array(ways, float),
        note="",
        times=[],
        width=1.0,
    )
    return bytes((store.serialize_ros1 if ros1 else store.serialize_cdr)(value, name))


def settings(fields):
    return ReadSettings(junction_topic="/seen", junction_fields=fields)


CENTER = "center=at.pose.position"


@pytest.mark.parametrize("encoding", ["cdr", "json"])
def test_degrees_must_be_said(logs, tmp_path, encoding):
    folder = written(logs, tmp_path / "run", [0.0, 90.0, -170.0], encoding=encoding)
    with pytest.raises(UsageError) as caught:
        read_run(folder, settings(f"{CENTER},branches=ways"))
    assert str(folder) in str(caught.value)
    assert "branches=ways: a heading of 90 is beyond ± 2π; add unit=deg" in str(caught.value)
    run = read_run(folder, settings(f"{CENTER},branches=ways,unit=deg"))
    np.testing.assert_allclose(run.detections.branches[0], np.deg2rad([0, 90, -170]))
    # Whoever says that they are radians is believed: some detectors count whole turns.
    run = read_run(folder, settings(f"{CENTER},branches=ways,unit=rad"))
    assert len(run.detections) == 30


@pytest.mark.parametrize("encoding", ["cdr", "json"])
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_headings_that_are_not_finite_are_left_out_and_counted(logs, tmp_path, encoding, unit):
    ways = [np.inf, 10.0, -np.inf, np.nan, 20.0]
    folder = written(logs, tmp_path / "run", ways, encoding=encoding)
    run = read_run(folder, settings(f"{CENTER},branches=ways,unit={unit}"))
    told = "/seen: 90 poses hold numbers that are not finite or absurdly large; left out"
    assert run.warnings == (told,)
    assert run.detections.branches.counts.tolist() == [2] * 30


@pytest.mark.parametrize("unit", ["unit=grad", "unit=", "unit=deg,unit=deg"])
def test_units_that_are_none(unit):
    with pytest.raises(UsageError, match="unit=deg"):
        settings(f"center=a,branches=b,{unit}")


@pytest.mark.parametrize("encoding", ["cdr", "json"])
@pytest.mark.parametrize(("length", "metres"), [("mm", 0.001), ("ft", 0.3048), ("m", 1.0)])
def test_lengths_have_a_unit(logs, tmp_path, encoding, length, metres):
    folder = written(logs, tmp_path / "run", [0.0, 1.0], encoding=encoding)
    plain = read_run(folder, settings(f"{CENTER},branches=ways")).detections
    scaled = read_run(folder, settings(f"{CENTER},branches=ways,length={length}")).detections
    np.testing.assert_allclose(scaled.centre, metres * plain.centre, rtol=1e-12)
    np.testing.assert_array_equal(scaled.branches.values, plain.branches.values)


WRONG = {
    "center=positon,branches=ways": "center=positon: a/Seen has header, at, corners, ways, note,",
    "center=at.pose.positon,branches=ways": (
        "center=at.pose.positon: geometry_msgs/Pose has position, orientation"
    ),
    "center=at,branches=ways": (
        "center=at: geometry_msgs/PoseWithCovariance has pose, covariance; "
        "expected a point or a pose"
    ),
    "center=width,branches=ways": (
        "center=width: leads into a value without fields; expected a point or a pose"
    ),
    "center=at.pose,branches=ways[].angle": (
        "branches=ways[].angle: leads into a value without fields"
    ),
    "center=at.pose,branches=ways.angle": "branches=ways.angle: a list is met where [] does not",
    "center=at.pose[],branches=ways": "center=at.pose[]: not a list",
    "center=at.pose,branches=header": (
        "branches=header: std_msgs/Header has stamp, frame_id; expected angles, quaternions, poses"
    ),
    "center=at.pose,branches=ways,frame=width": "frame=width: the name of a frame is no text",
    "center=at.pose,branches=ways,frame=header.frame": "frame=header.frame: std_msgs/Header has",
    "center=at.pose,branches=ways,stamp=at": "stamp=at: a time is neither",
    "each=width,center=x,branches=y": "center=x: leads into a value without fields",
}


@pytest.fixture(scope="module")
def of_both_kinds(logs, tmp_path_factory):
    """The same log with ROS 2's messages, and with ROS 1's."""
    folders = [tmp_path_factory.mktemp("ros") / "run" for _ in range(2)]
    return [written(logs, folder, [0.0, 1.0], ros1=ros1) for ros1, folder in enumerate(folders)]


@pytest.mark.parametrize("fields", WRONG)
@pytest.mark.parametrize("ros1", [False, True])
def test_a_path_that_leads_nowhere_is_named(of_both_kinds, monkeypatch, fields, ros1):
    folder = of_both_kinds[ros1]
    told = WRONG[fields].replace("has stamp", "has seq, stamp") if ros1 else WRONG[fields]
    problems = inspect_log(folder, settings(fields)).problems
    assert any(told in problem for problem in problems), problems
    monkeypatch.setattr("topobatch.ingest.survey.walk", None)  # nothing is read
    with pytest.raises(UsageError) as caught:
        read_run(folder, settings(fields))
    assert told in str(caught.value)
    assert f"{folder}: /seen: --junction-fields: " in str(caught.value)


def test_what_some_messages_lack_is_told_with_the_reason(logs, tmp_path):
    folder = written(logs, tmp_path / "run", [0.0, 1.0], encoding="json", last="none")
    run = read_run(folder, settings(f"{CENTER},branches=ways"))
    assert run.warnings == (
        "/seen: 1 message could not be decoded (branches=ways: a number is missing); left out",
    )


def test_points_at_the_centre_are_no_branch(logs, tmp_path):
    where = {"x": 0.5, "y": 0.25}
    folder = written(logs, tmp_path / "run", [{"x": 2.0, "y": 0.25}], encoding="json", last=[where])
    run = read_run(folder, settings(f"{CENTER},branches=ways"))
    assert len(run.detections) == 29
    assert "a branch points to its own centre" in run.warnings[0]


def test_a_topic_is_not_odometry_and_junctions():
    with pytest.raises(UsageError, match="both"):
        ReadSettings(
            odometry_topic="odom", junction_topic="/odom", junction_fields="center=a,branches=b"
        )
