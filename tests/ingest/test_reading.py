"""Which topics are used, in which frames and by which fields."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.ingest.reading import ReadSettings, find_logs, inspect_log, log_fingerprint, read_run
from topobatch.topology.errors import LogError, UsageError
from topobatch.topology.se2 import apply, wrap


def split(logs):
    messages = logs.drive()
    return (
        [m for m in messages if m.topic == "/odom"],
        [m for m in messages if m.topic == "/junctions"],
    )


def by_time(*lists):
    return sorted((m for part in lists for m in part), key=lambda m: m.log_ns)


def test_odometry_wins_over_tf_and_poses(logs, tmp_path):
    odometry, seen = split(logs)
    tf = logs.relabelled(odometry, topic="/tf", type_name=logs.TF)
    goal = logs.relabelled(odometry[:5], topic="/goal", type_name=logs.POSE_STAMPED, child="")
    wheel = logs.relabelled(odometry, topic="/wheel")
    run = read_run(logs.mcap(tmp_path / "a.mcap", by_time(wheel, tf, goal, seen)))
    assert run.source["odometry"]["topic"] == "/wheel"
    run = read_run(logs.bag(tmp_path / "b.bag", by_time(odometry, wheel, seen)))
    assert run.source["odometry"]["topic"] == "/odom"
    named = read_run(tmp_path / "b.bag", ReadSettings(odometry_topic="wheel"))
    assert named.source["odometry"]["topic"] == "/wheel"


@pytest.mark.parametrize("indexed", [True, False])
def test_messages_of_another_type_on_a_topic_are_left_out_and_counted(logs, tmp_path, indexed):
    odometry, seen = split(logs)
    poses = logs.relabelled(odometry[:7], topic="/odom", type_name=logs.POSE_STAMPED, child="")
    arrays = logs.relabelled(seen[:3], topic="/odom")
    mixed = by_time(odometry, poses, arrays, seen)
    run = read_run(logs.mcap(tmp_path / "a", mixed, use_statistics=indexed))
    same = read_run(logs.mcap(tmp_path / "b", by_time(odometry, seen)))
    assert run.warnings == ("/odom: 10 messages are of another type; left out",)
    assert run.odometry.pose.tobytes() == same.odometry.pose.tobytes()
    assert run.source["odometry"] == same.source["odometry"]


@pytest.mark.parametrize("container", ["mcap", "bag", "db3", "unindexed"])
def test_two_candidates_ask_for_the_flag(logs, tmp_path, container):
    odometry, seen = split(logs)
    two = [logs.relabelled(odometry, topic=name) for name in ("/left", "/right")]
    write = {
        "mcap": lambda m: logs.mcap(tmp_path / "a.mcap", m),
        "bag": lambda m: logs.bag(tmp_path / "a.bag", m),
        "db3": lambda m: logs.ros2_folder(tmp_path / "a", m),
        "unindexed": lambda m: logs.mcap(tmp_path / "a.mcap", m, use_statistics=False),
    }[container]
    path = write(by_time(*two, seen))
    with pytest.raises(UsageError, match=r"/left, /right; choose with --odometry-topic"):
        read_run(path)
    assert any("--odometry-topic" in text for text in inspect_log(path).problems)
    chosen = read_run(path, ReadSettings(odometry_topic="/right"))
    assert len(chosen.odometry) == 300


@pytest.mark.parametrize("ros1", [False, True])
def test_tf_serves_where_there_is_no_odometry(logs, tmp_path, ros1):
    odometry, seen = split(logs)
    tf = logs.relabelled(odometry, topic="/tf", type_name=logs.TF)
    wheel = [
        replace(m, frame="base_link", child="wheel", log_ns=m.log_ns + 1, poses=m.poses * 2)
        for m in tf
    ]
    messages = by_time(tf, wheel, logs.relabelled(tf[::7], frame="map", child="odom"), seen)
    write = logs.bag if ros1 else logs.mcap
    run = read_run(write(tmp_path / "a", messages))
    whole = read_run(logs.mcap(tmp_path / "whole.mcap", logs.drive()))
    assert run.odometry.pose.tobytes() == whole.odometry.pose.tobytes()
    assert (run.odometry.frame, run.odometry.child_frame) == ("odom", "base_link")
    assert run.source["odometry"]["type"] == logs.TF


def test_tf_without_odom_gives_way_to_a_pose(logs, tmp_path):
    odometry, seen = split(logs)
    tf = logs.relabelled(odometry, topic="/tf", type_name=logs.TF, frame="map")
    pose = logs.relabelled(odometry, topic="/pose", type_name=logs.POSE_STAMPED, child="")
    run = read_run(logs.mcap(tmp_path / "a.mcap", by_time(tf, pose, seen)))
    assert run.source["odometry"]["topic"] == "/pose"
    with pytest.raises(LogError, match="no transform from an odom frame"):
        read_run(logs.mcap(tmp_path / "b.mcap", by_time(tf, seen)))


def test_missing_topics_are_named(logs, tmp_path):
    odometry, seen = split(logs)
    with pytest.raises(LogError, match=r"no odometry found.*topics: /junctions"):
        read_run(logs.mcap(tmp_path / "a.mcap", seen))
    with pytest.raises(LogError, match=r"no junction detections found.*topics: /odom"):
        read_run(logs.mcap(tmp_path / "b.mcap", odometry))
    whole = logs.mcap(tmp_path / "c.mcap", logs.drive())
    with pytest.raises(LogError, match=r"no messages of /nothing"):
        read_run(whole, ReadSettings(odometry_topic="/nothing"))
    with pytest.raises(UsageError, match=r"/junctions is geometry_msgs/msg/PoseArray"):
        read_run(whole, ReadSettings(odometry_topic="/junctions"))


def test_detections_in_the_odometry_frame_are_turned_into_the_robots(logs, tmp_path):
    odometry, seen = split(logs)
    run = read_run(logs.mcap(tmp_path / "a.mcap", by_time(odometry, seen)))
    pose = dict(zip(run.odometry.time_ns.tolist(), run.odometry.pose, strict=True))

    def moved(message):
        T_odom_base = pose[message.stamp_ns]
        x, y = apply(T_odom_base, np.array(message.poses[0][:2]))
        yaws = [2 * np.arctan2(p[5], p[6]) + T_odom_base[2] for p in message.poses]
        poses = tuple(logs.yaw_pose(x, y, yaw) for yaw in yaws)
        return replace(message, frame="/odom", poses=poses)

    turned = read_run(logs.mcap(tmp_path / "b.mcap", by_time(odometry, [moved(m) for m in seen])))
    np.testing.assert_allclose(turned.detections.centre, run.detections.centre, atol=1e-9)
    difference = wrap(turned.detections.branches.values - run.detections.branches.values)
    np.testing.assert_allclose(difference, 0, atol=1e-9)


def test_a_foreign_frame_is_an_error_or_a_warning(logs, tmp_path):
    odometry, seen = split(logs)
    foreign = logs.relabelled(seen, frame="camera")
    with pytest.raises(LogError, match=r"'camera', expected 'base_link' or 'odom'"):
        read_run(logs.mcap(tmp_path / "a.mcap", by_time(odometry, foreign)))
    run = read_run(logs.mcap(tmp_path / "b.mcap", by_time(odometry, seen[:20], foreign[20:])))
    assert len(run.detections) == 20
    assert any("'camera'" in text and "10 detections" in text for text in run.warnings)


def test_several_junctions_of_one_message_and_json_in_strings(logs, tmp_path):

    odometry, seen = split(logs)
    folder = tmp_path / "run"
    folder.mkdir()
    logs.mcap(folder / "a.mcap", odometry)
    body = {
        "header": {"frame_id": "base_link"},
        "found": [
            {"at": {"x": 1.0, "y": 2.0}, "ways": [0.5, 1.5]},
            {"at": {"x": -1.0, "y": 2.5}, "ways": [{"x": -1.0, "y": 3.5}]},
        ],
    }
    payloads = []
    for message in seen:
        stamp = {"sec": message.stamp_ns // 10**9, "nsec": message.stamp_ns % 10**9}
        inner = {**body, "header": {"frame_id": "base_link", "stamp": stamp}}
        raw = json.dumps({"data": json.dumps(inner), **inner}).encode()
        payloads.append((message.log_ns, raw))
    logs.mcap_topic(folder / "b.mcap", "/seen", "json", ("Seen", "jsonschema", "{}"), payloads)
    for prefix in ("", "data."):
        fields = f"each={prefix}found[],center=at,branches=ways"
        run = read_run(folder, ReadSettings(junction_topic="/seen", junction_fields=fields))
        assert len(run.detections) == 60
        assert run.detections.branches.counts.tolist() == [2, 1] * 30
        np.testing.assert_allclose(run.detections.branches[0], [0.5, 1.5])
        np.testing.assert_allclose(run.detections.branches[1], [np.pi / 2])
        assert run.detections.centre[:2].tolist() == [[1.0, 2.0], [-1.0, 2.5]]


@pytest.mark.parametrize(
    "fields",
    [
        "",
        "center",
        "center=a",
        "branches=b",
        "center=a,branches=b,x=c",
        "center=__dict__,branches=b",
        "center=a,center=b,branches=c",
    ],
)
def test_a_wrong_mapping_is_a_usage_error(fields):
    with pytest.raises(UsageError, match="--junction-fields"):
        ReadSettings(junction_fields=fields)


def test_an_unusual_definition_is_decoded_by_its_schema(logs, tmp_path):
    """A fork of Odometry with a field in front must not be read by the usual layout."""
    from rosbags.typesys import get_types_from_msg

    store = logs.store_of(False)
    usual, _ = store.generate_msgdef(logs.ODOMETRY, ros_version=2)
    text = "float64 quality\n" + usual
    fork = logs.new_store(False)
    types = get_types_from_msg(text, "nav_msgs/msg/Odometry")
    del fork.fielddefs["nav_msgs/msg/Odometry"]
    fork.register({"nav_msgs/msg/Odometry": types["nav_msgs/msg/Odometry"]})
    odometry, seen = split(logs)
    folder = tmp_path / "run"
    folder.mkdir()
    logs.mcap(folder / "seen.mcap", seen)
    payloads = []
    for message in odometry:
        value = logs.ros_object(message, store, False)
        forked = fork.types["nav_msgs/msg/Odometry"](
            quality=1.0,
            header=value.header,
            child_frame_id=value.child_frame_id,
            pose=value.pose,
            twist=value.twist,
        )
        raw = bytes(fork.serialize_cdr(forked, "nav_msgs/msg/Odometry"))
        payloads.append((message.log_ns, raw))
    schema = "nav_msgs/msg/Odometry", "ros2msg", text
    logs.mcap_topic(folder / "odom.mcap", "/odom", "cdr", schema, payloads)
    run = read_run(folder)
    same = read_run(logs.mcap(tmp_path / "whole.mcap", logs.drive()))
    assert run.odometry.pose.tobytes() == same.odometry.pose.tobytes()


def test_find_logs_by_content(logs, tmp_path):
    logs.mcap(tmp_path / "b.mcap", logs.drive(50))
    logs.bag(tmp_path / "deep.bag", logs.drive(50))
    (tmp_path / "x").mkdir()
    logs.bag(tmp_path / "x" / "c.bag.active", logs.drive(50))
    logs.ros2_folder(tmp_path / "x" / "bag", logs.drive(50))
    (tmp_path / "notes.txt").write_text("no log")
    found = find_logs([tmp_path])
    assert found == sorted(
        tmp_path / name for name in ("b.mcap", "deep.bag", "x/bag", "x/c.bag.active")
    )
    assert find_logs([tmp_path / "b.mcap", tmp_path]) == found
    (tmp_path / "nothing").mkdir()
    with pytest.raises(LogError, match="no log in this folder"):
        find_logs([tmp_path / "nothing"])
    with pytest.raises(LogError, match="no such file"):
        find_logs([tmp_path / "missing.bag"])


def test_fingerprints_follow_content_and_not_names(logs, tmp_path):
    a = logs.mcap(tmp_path / "a.mcap", logs.drive())
    b = tmp_path / "b.mcap"
    b.write_bytes(a.read_bytes())
    assert log_fingerprint(a) == log_fingerprint(b)
    b.write_bytes(a.read_bytes()[:-1] + b"x")
    assert log_fingerprint(a) != log_fingerprint(b)


def test_a_folder_that_is_no_bag_may_have_a_metadata_file(logs, tmp_path):
    first = logs.mcap(tmp_path / "a.mcap", logs.drive())
    second = logs.bag(tmp_path / "b.bag", logs.drive())
    (tmp_path / "metadata.yaml").write_text("title: a data set\n")
    assert find_logs([tmp_path]) == [first, second]


def test_what_is_hidden_broken_or_closed_costs_no_other_log(logs, tmp_path, monkeypatch):
    log = logs.mcap(tmp_path / "run_0.mcap", logs.drive())
    empty, closed = tmp_path / "run_1.mcap", tmp_path / "closed"
    empty.write_bytes(b"")
    (tmp_path / "._run_0.mcap").write_bytes(b"\0\5\26\7")
    closed.mkdir()
    listed = Path.iterdir

    def iterdir(path):
        if path == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return listed(path)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    assert find_logs([tmp_path]) == [closed, log, empty]
    with pytest.raises(LogError, match="closed: cannot be listed"):
        read_run(closed)


@pytest.mark.parametrize("names", ["run_{}.bag", "x_2024-05-01-10-0{}-00_{}.bag"])
def test_parts_of_a_bag_are_one_run_though_the_last_was_cut(logs, tmp_path, names):
    """ROS 1 puts the time at which a part was begun into its name."""
    drive = logs.drive()
    for part, some in enumerate((drive[:200], drive[200:])):
        path = logs.bag(tmp_path / names.format(part, part), some, chunk=2000)
    assert find_logs([tmp_path]) == [tmp_path]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert find_logs([tmp_path]) == [tmp_path]
    run = read_run(tmp_path)
    assert any("cut short" in text for text in run.warnings)
    assert 200 < run.source["odometry"]["messages"] < 300


def test_a_file_packed_by_hand_is_found_below_a_folder(logs, tmp_path):
    import zstandard

    raw = logs.mcap(tmp_path / "run.mcap", logs.drive()).read_bytes()
    (tmp_path / "run.mcap").unlink()
    packed = tmp_path / "run.mcap.zst"
    packed.write_bytes(zstandard.compress(raw))
    assert find_logs([tmp_path]) == [packed]


def test_a_file_that_the_metadata_does_not_name_is_reported(logs, tmp_path):
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    assert read_run(folder).warnings == ()
    logs.mcap(folder / "other.mcap", logs.drive())
    run = read_run(folder)
    assert "metadata.yaml does not name other.mcap, which is read all the same" in run.warnings


def test_the_odometry_of_another_robot_in_tf_is_reported(logs, tmp_path):
    drive = logs.drive()
    odometry = [m for m in drive if m.topic == "/odom"]
    tf = [
        replace(m, topic="/tf", type_name=logs.TF, frame=f"{robot}/odom", child=f"{robot}/base")
        for m in odometry
        for robot in ("r1", "r2")
    ]
    seen = [replace(m, frame="r1/base") for m in drive if m.topic != "/odom"]
    run = read_run(logs.mcap(tmp_path / "run.mcap", tf + seen))
    assert len(run.odometry) == 300
    (warning,) = run.warnings
    said = "/tf: also holds the odometry of another robot (r2/odom → r2/base); left out"
    assert warning == f"{said}; --base-frame chooses"


def test_what_is_missing_is_said_with_what_is_damaged(logs, tmp_path):
    path = logs.mcap(tmp_path / "run.mcap", [m for m in logs.drive() if m.topic == "/odom"])
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(LogError, match=r"no junction detections found .*; the log is cut short"):
        read_run(path)


IDL = {
    "my_msgs/msg/Junction": """// generated from my_msgs/msg/Junction.msg
#include "geometry_msgs/msg/Point.idl"
#include "std_msgs/msg/Header.idl"

module my_msgs {
  module msg {
    struct Junction {
      std_msgs::msg::Header header;
      @verbatim (language="comment", text="in the robot's frame")
      geometry_msgs::msg::Point center;
      sequence<double> angles;
    };
  };
};
""",
    "geometry_msgs/msg/Point": (
        "module geometry_msgs { module msg { struct Point { double x; double y; double z; }; }; };"
    ),
    "std_msgs/msg/Header": """#include "builtin_interfaces/msg/Time.idl"
module std_msgs { module msg {
  struct Header { builtin_interfaces::msg::Time stamp; string frame_id; };
}; };
""",
    "builtin_interfaces/msg/Time": (
        "module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };"
    ),
}


def test_a_definition_of_several_idl_files_is_read(logs, tmp_path):
    """As ROS 2 puts them into MCAP: one behind the other, each below a line of equal signs."""
    from mcap.writer import Writer

    drive, store = logs.drive(), logs.store_of(False)
    definition = "".join(f"{'=' * 80}\nIDL: {name}\n{text}\n" for name, text in IDL.items())
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        schema = logs._schema(writer, drive[0], "cdr", store, True)
        odometry = writer.register_channel("/odom", "cdr", schema)
        schema = writer.register_schema("my_msgs/msg/Junction", "ros2idl", definition.encode())
        junctions = writer.register_channel("/junctions", "cdr", schema)
        for message in drive:
            channel, raw = odometry, logs.payload(message, "cdr", store)
            if message.topic == "/junctions":
                header = struct.pack("<iII", *divmod(message.stamp_ns, 10**9), 10) + b"base_link\0"
                gap = bytes(-len(header) % 8)
                raw = struct.pack("<5d", 0.5, 0.125, 0.0, -1.0, 1.0)
                raw = raw[:24] + struct.pack("<II", 2, 0) + raw[24:]
                channel, raw = junctions, b"\0\1\0\0" + header + gap + raw
            writer.add_message(channel, message.log_ns, raw, message.log_ns)
        writer.finish()
    fields = ReadSettings(junction_fields="center=center,branches=angles[]")
    run = read_run(path, fields)
    assert (run.warnings, len(run.detections)) == ((), 30)
    np.testing.assert_allclose(run.detections.centre, [[0.5, 0.125]] * 30)
    np.testing.assert_allclose(run.detections.branches.values, [-1.0, 1.0] * 30)


def test_json_may_write_whole_numbers_with_a_point(logs, tmp_path):
    path = logs.mcap(tmp_path / "run.mcap", logs.drive(), encoding="json", profile="")
    whole = read_run(path)
    written = logs.foxglove_json

    def pointed(message):
        value = json.loads(written(message))
        value["timestamp"] = {name: float(part) for name, part in value["timestamp"].items()}
        return json.dumps(value).encode()

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(logs, "foxglove_json", pointed)
        logs.mcap(path, logs.drive(), encoding="json", profile="")
    run = read_run(path)
    assert run.warnings == ()
    assert run.odometry.time_ns.tolist() == whole.odometry.time_ns.tolist()
