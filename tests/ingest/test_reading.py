"""Which topics are used, in which frames and by which fields."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.logs.schema import LAYOUTS
from topobatch.ingest.reading import ReadSettings, find_logs, inspect_log, read_run
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
    # Both questions at once.
    both = [logs.relabelled(seen, topic=name) for name in ("/near", "/far")]
    path = logs.bag(tmp_path / "b.bag", by_time(*two, *both))
    with pytest.raises(UsageError, match=r"choose with --junction-topic; 2 .* --odometry-topic$"):
        read_run(path)


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


@pytest.mark.parametrize("ros1", [False, True])
def test_the_layouts_are_those_of_ros(logs, ros1):
    store = logs.store_of(ros1)
    for name in LAYOUTS.keys() - {"tf/msg/tfMessage"}:
        assert store.generate_msgdef(name, ros_version=1)[1] == LAYOUTS[name][ros1]


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
