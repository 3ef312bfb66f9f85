"""Every example of docs/detections.md, run on a log that is made as the page says."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings

PAGE = (Path(__file__).parents[2] / "docs" / "detections.md").read_text()
ODOMETRY = "nav_msgs/msg/Odometry"

# Of vision_msgs 4, what a detection in space is made of.
DETECTIONS = """\
std_msgs/Header header
vision_msgs/Detection3D[] detections
===
MSG: vision_msgs/Detection3D
std_msgs/Header header
ObjectHypothesisWithPose[] results
vision_msgs/BoundingBox3D bbox
string id
===
MSG: vision_msgs/ObjectHypothesisWithPose
ObjectHypothesis hypothesis
geometry_msgs/PoseWithCovariance pose
===
MSG: vision_msgs/ObjectHypothesis
string class_id
float64 score
===
MSG: vision_msgs/BoundingBox3D
geometry_msgs/Pose center
geometry_msgs/Vector3 size
"""


def section(title: str) -> str:
    """The text below a heading, up to the next one."""
    found = re.search(rf"^#+ {re.escape(title)}\n(.*?)(?=^#+ |\Z)", PAGE, re.DOTALL | re.MULTILINE)
    assert found, title
    return found[1]


def block(title: str, language: str) -> str:
    (text,) = re.findall(rf"^```{language}\n(.*?)^```$", section(title), re.DOTALL | re.MULTILINE)
    return str(text)


class Maker:
    """Makes messages of the types that rosbags knows, and of those that are registered."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)

    def register(self, definition: str, name: str) -> None:
        from rosbags.typesys import get_types_from_msg

        text = definition.replace("\n===\n", f"\n{'=' * 80}\n")
        types = get_types_from_msg(text, name)
        self.store.register({n: t for n, t in types.items() if n not in self.store.types})

    def __call__(self, name: str, **given: Any) -> Any:
        """A message; what is not given is empty or zero."""
        from rosbags.interfaces import Nodetype

        def empty(node: int, of: Any) -> Any:
            if node == Nodetype.NAME:
                return self(of)
            if node == Nodetype.SEQUENCE:
                return np.zeros(0, of[0][1][0]) if of[0][0] == Nodetype.BASE else []
            if node == Nodetype.ARRAY:
                return np.zeros(of[1], of[0][1][0])
            return {"string": "", "bool": False}.get(of[0], 0)

        _, fields = self.store.fielddefs[name]
        values = {n: given[n] if n in given else empty(*described) for n, described in fields}
        return self.store.types[name](**values)

    def header(self, time_ns: int, frame: str) -> Any:
        stamp = self("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        return self("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def pose(self, x: float, y: float, yaw: float) -> Any:
        turn = {"z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
        return self(
            "geometry_msgs/msg/Pose",
            position=self("geometry_msgs/msg/Point", x=float(x), y=float(y)),
            orientation=self("geometry_msgs/msg/Quaternion", **turn),
        )


class Log:
    """A ROS 2 bag folder in the making: odometry of a simulated run, and what is added to it."""

    def __init__(self, make: Maker, run: Any) -> None:
        self.make, self.run = make, run
        self.messages: list[tuple[int, str, str, Any]] = []
        poses = zip(run.odometry.time_ns.tolist(), run.odometry.pose.tolist(), strict=True)
        for time_ns, pose in poses:
            value = make(
                ODOMETRY,
                header=make.header(time_ns, "odom"),
                child_frame_id="base_link",
                pose=make("geometry_msgs/msg/PoseWithCovariance", pose=make.pose(*pose)),
            )
            self.add(time_ns, "/odom", ODOMETRY, value)

    def add(self, time_ns: int, topic: str, type_name: str, value: Any) -> None:
        self.messages.append((time_ns, topic, type_name, value))

    @property
    def detections(self) -> Any:
        found = self.run.detections
        for k, time_ns in enumerate(found.time_ns.tolist()):
            yield time_ns, found.centre[k].tolist(), found.branches[k].tolist()

    def write(self, path: Path) -> Path:
        from rosbags.rosbag2 import StoragePlugin, Writer

        with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            links: dict[str, Any] = {}
            for time_ns, topic, type_name, value in sorted(self.messages, key=lambda m: m[0]):
                if topic not in links:
                    links[topic] = writer.add_connection(
                        topic, type_name, typestore=self.make.store
                    )
                raw = bytes(self.make.store.serialize_cdr(value, type_name))
                writer.write(links[topic], time_ns, raw)
        return path


@pytest.fixture(scope="module")
def run() -> Any:
    settings = ScenarioSettings(runs=1, junctions_per_run=8, drift="low", odometry_hz=10, seed=5)
    return simulate_scenario(settings).simulated[0].run


def pose_array(log: Log) -> None:
    make = log.make
    for time_ns, centre, yaws in log.detections:
        poses = [make.pose(*centre, yaw) for yaw in yaws]
        header = make.header(time_ns, "base_link")
        value = make("geometry_msgs/msg/PoseArray", header=header, poses=poses)
        log.add(time_ns, "/crossings", "geometry_msgs/msg/PoseArray", value)


def marker_array(log: Log) -> None:
    make = log.make
    for time_ns, centre, yaws in log.detections:
        header = make.header(time_ns, "base_link")
        markers = [
            make("visualization_msgs/msg/Marker", header=header, id=k, pose=make.pose(*centre, yaw))
            for k, yaw in enumerate(yaws)
        ]
        value = make("visualization_msgs/msg/MarkerArray", markers=markers)
        log.add(time_ns, "/junction_markers", "visualization_msgs/msg/MarkerArray", value)


def vision_msgs(log: Log) -> None:
    make = log.make
    make.register(DETECTIONS, "vision_msgs/msg/Detection3DArray")
    for time_ns, centre, yaws in log.detections:
        results = [
            make(
                "vision_msgs/msg/ObjectHypothesisWithPose",
                pose=make("geometry_msgs/msg/PoseWithCovariance", pose=make.pose(*centre, yaw)),
            )
            for yaw in yaws
        ]
        box = make("vision_msgs/msg/BoundingBox3D", center=make.pose(*centre, 0.0))
        # Nobody fills in the headers of the items.
        item = make("vision_msgs/msg/Detection3D", results=results, bbox=box)
        header = make.header(time_ns, "base_link")
        value = make("vision_msgs/msg/Detection3DArray", header=header, detections=[item])
        log.add(time_ns, "/detections", "vision_msgs/msg/Detection3DArray", value)


def own_message(log: Log) -> None:
    make, name = log.make, "my_msgs/msg/Crossing"
    make.register(block("A message of one's own", ""), name)
    for time_ns, (x, y), yaws in log.detections:
        frontiers = [
            make("my_msgs/msg/Frontier", width=1.0, angle_deg=float(np.rad2deg(yaw)))
            for yaw in yaws
        ]
        centre = make("geometry_msgs/msg/Point", x=x, y=y)
        header = make.header(time_ns, "base_link")
        value = make(name, header=header, center=centre, frontiers=frontiers)
        log.add(time_ns, "/crossings", name, value)


def json_in_a_string(log: Log) -> None:
    shown = json.loads(block("JSON in a string", "json"))
    (junction,) = shown["junctions"]
    assert set(junction["at"]) == set(junction["exits"][0]) == {"x", "y"}
    for time_ns, (x, y), yaws in log.detections:
        exits = [{"x": x + np.cos(yaw), "y": y + np.sin(yaw)} for yaw in yaws]
        found = [{"at": {"x": x, "y": y}, "exits": exits}]
        told = {**shown, "time": time_ns / 1e9, "junctions": found}
        value = log.make("std_msgs/msg/String", data=json.dumps(told))
        log.add(time_ns, "/junctions_json", "std_msgs/msg/String", value)


EXAMPLES = {
    "PoseArray": pose_array,
    "MarkerArray": marker_array,
    "vision_msgs": vision_msgs,
    "A message of one's own": own_message,
    "JSON in a string": json_in_a_string,
}


def called(title: str, log: Path) -> list[str]:
    """The arguments of an example's command, with the log in place of the one it names."""
    words = shlex.split(block(title, "sh").replace("\\\n", " "))
    assert words[:3] == ["topobatch", "ingest", "run1.mcap"]
    return [str(log), *words[3:]]


def test_every_example_of_the_page_is_tried() -> None:
    assert re.findall(r"^### (.*)$", section_of_examples(), re.MULTILINE) == list(EXAMPLES)


def section_of_examples() -> str:
    return PAGE.partition("## Examples")[2].partition("\n## ")[0]


@pytest.mark.parametrize("title", EXAMPLES)
def test_an_example_reads_what_the_detector_saw(topobatch, run, tmp_path, title):
    from topobatch.ingest.reading import ReadSettings, read_run

    log = Log(Maker(), run)
    EXAMPLES[title](log)
    path = log.write(tmp_path / "run1")
    arguments = called(title, path)
    done = topobatch("ingest", *arguments, "-w", tmp_path / "ws")
    assert (done.code, done.err) == (0, ""), done
    assert (tmp_path / "ws" / "maps" / "run1.json").exists()
    shown = topobatch("info", *arguments)
    assert (shown.code, "problem" in shown.out) == (0, False), shown
    given = dict(zip(arguments[1::2], arguments[2::2], strict=True))
    settings = ReadSettings(
        junction_topic=given["--junction-topic"], junction_fields=given.get("--junction-fields")
    )
    found, expected = read_run(path, settings).detections, run.detections
    # Times as numbers of seconds are good to a microsecond.
    np.testing.assert_allclose(found.time_ns, expected.time_ns, atol=1000)
    np.testing.assert_allclose(found.centre, expected.centre, atol=1e-6)
    assert found.branches.counts.tolist() == expected.branches.counts.tolist()
    turned = np.exp(1j * found.branches.values) - np.exp(1j * expected.branches.values)
    np.testing.assert_allclose(np.abs(turned), 0, atol=1e-6)


# The detector: a stand-in for rclpy that hands it scans, and keeps what it publishes.


class Corridors:
    """Rectangles of free space [m], and what a laser sees in them."""

    free = np.array([[-12, 11, -1, 1], [-1, 1, -12, 12], [9, 11, -12, 12]], float)

    def ranges(self, x: float, y: float, yaw: float, angle: Any) -> Any:
        along = np.arange(0, 8, 0.02)
        px = x + np.cos(angle + yaw)[:, None] * along
        py = y + np.sin(angle + yaw)[:, None] * along
        inside = np.zeros(px.shape, bool)
        for low, high, left, right in self.free:
            inside |= (px > low) & (px < high) & (py > left) & (py < right)
        wall = (~inside).argmax(axis=1)
        return np.where(inside.all(axis=1), np.inf, along[wall])


@pytest.fixture
def detector(monkeypatch):
    """The class of the page's node, and a list that fills with what it publishes."""
    published: list[Any] = []

    class Node:
        def __init__(self, name: str) -> None:
            self.name = name

        def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
            assert topic == "junctions"
            return SimpleNamespace(publish=published.append)

        def create_subscription(self, kind: Any, topic: str, hear: Any, depth: int) -> None:
            assert topic == "scan"

    spun: list[Any] = []

    def pose() -> Any:
        at = SimpleNamespace(x=0.0, y=0.0, z=0.0)
        return SimpleNamespace(position=at, orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0))

    members = {
        "rclpy": {"init": lambda: None, "spin": spun.append},
        "rclpy.node": {"Node": Node},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"Pose": pose, "PoseArray": SimpleNamespace},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"LaserScan": object},
    }
    for name, values in members.items():
        module = ModuleType(name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, name, module)
    code = block("A detector in 30 lines", "python")
    lines = [line for line in code.splitlines() if line.strip()]
    assert len(lines) <= 30
    exec(code, {"__name__": "__main__"})
    (node,) = spun
    return node, published


def test_the_detector_of_the_page_maps_a_building(topobatch, detector, run, tmp_path):
    node, published = detector
    angle_min, step = -np.pi, np.pi / 360
    angle = angle_min + step * np.arange(720)
    world, laser_m = Corridors(), 0.25
    east = [(x, 0.0, 0.0) for x in np.arange(-6, 10, 0.1)]
    north = [(10.0, y, np.pi / 2) for y in np.arange(0, 6, 0.1)]
    turn = [(10.0, 0.0, yaw) for yaw in np.linspace(0, np.pi / 2, 10)]
    make = Maker()
    drive = np.array([*east, *turn, *north])
    time_ns = 1_700_000_000 * 10**9 + 200_000_000 * np.arange(len(drive))
    odometry = SimpleNamespace(time_ns=time_ns, pose=drive)
    log = Log(make, SimpleNamespace(odometry=odometry, detections=None))
    mount = make(
        "geometry_msgs/msg/TransformStamped",
        header=make.header(int(time_ns[0]), "base_link"),
        child_frame_id="laser",
        transform=make(
            "geometry_msgs/msg/Transform",
            translation=make("geometry_msgs/msg/Vector3", x=laser_m),
            rotation=make("geometry_msgs/msg/Quaternion", w=1.0),
        ),
    )
    tf = make("tf2_msgs/msg/TFMessage", transforms=[mount])
    log.add(int(time_ns[0]), "/tf_static", "tf2_msgs/msg/TFMessage", tf)
    for now, (x, y, yaw) in zip(time_ns.tolist(), drive.tolist(), strict=True):
        at = x + laser_m * np.cos(yaw), y + laser_m * np.sin(yaw)
        header = make.header(now, "laser")
        node.look(
            SimpleNamespace(
                header=header,
                angle_min=angle_min,
                angle_increment=step,
                ranges=world.ranges(*at, yaw, angle),
            )
        )
        while published:
            found = published.pop()
            poses = [
                make.pose(0.0, 0.0, 2 * np.arctan2(p.orientation.z, p.orientation.w))
                for p in found.poses
            ]
            value = make("geometry_msgs/msg/PoseArray", header=found.header, poses=poses)
            log.add(now, "/junctions", "geometry_msgs/msg/PoseArray", value)
    path = log.write(tmp_path / "run1")
    done = topobatch("ingest", path, "-w", tmp_path / "ws")
    assert done.code == 0, done
    document = json.loads((tmp_path / "ws" / "maps" / "run1.json").read_text())
    crossing, tee = document["nodes"]
    assert (len(crossing["branches"]), len(tee["branches"])) == (4, 3)
    apart = np.hypot(crossing["x"] - tee["x"], crossing["y"] - tee["y"])
    assert apart == pytest.approx(10, abs=0.2)
