"""Which lasers of a log are used together, and that two are no worse than one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from rosbags.highlevel import AnyReader

from topobatch.ingest.inspection import as_read
from topobatch.ingest.mapping import build_map
from topobatch.ingest.reading import inspect_log, read_run
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import LaserSettings, ScenarioSettings
from topobatch.simulation.writing import write_run
from topobatch.topology.run import Run

LASER = LaserSettings(beams=120, rate_hz=4.0, door_share=0.0, people_per_100_m=0.0)
LEFT, RIGHT = slice(60, 120), slice(0, 60)
JUNCTIONS = 4
"""Of the office that the robot sees; one sector alone shows one more."""
Row = tuple[str, str, int, bytes]
Sectors = list[tuple[str, str, slice, int]]
"""Topic, frame, beams, and how much later [ns], of the lasers that one is dealt out to."""


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    """The messages of a run with one laser."""
    settings = ScenarioSettings(
        "office", runs=1, junctions_per_run=6, laser=LASER, tells_junctions=False, seed=3
    )
    log = write_run(tmp_path_factory.mktemp("office"), simulate_scenario(settings).simulated[0])
    with AnyReader([log]) as reader:
        return [(c.topic, c.msgtype, t, bytes(raw)) for c, t, raw in reader.messages()]


@pytest.fixture
def read(office: list[Row], sensors: ModuleType, tmp_path: Path) -> Callable[..., tuple[Path, Run]]:
    """Writes the run with its laser dealt out to several, and reads it."""

    def log_of(sectors: Sectors, without: str = "") -> tuple[Path, Run]:
        rows: list[Row] = []
        for topic, kind, log_ns, raw in office:
            if topic == without:
                continue
            if topic == "/tf_static":
                pose = (0.15, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)
                frames = {frame for _, frame, _, _ in sectors if frame != "nowhere"}
                rows += [
                    (topic, kind, log_ns, sensors.mount(name, pose)) for name in sorted(frames)
                ]
            elif topic == "/scan":
                rows += [_part(sensors, kind, log_ns, raw, sector) for sector in sectors]
            else:
                rows.append((topic, kind, log_ns, raw))
        log = sensors.mcap(tmp_path / f"log{len(list(tmp_path.iterdir()))}.mcap", rows)
        return log, read_run(log)

    return log_of


def _part(
    sensors: ModuleType, kind: str, log_ns: int, raw: bytes, sector: tuple[str, str, slice, int]
) -> Row:
    topic, frame, beams, later_ns = sector
    scan = sensors.ROS2.deserialize_cdr(raw, kind)
    stamp_ns = scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec + later_ns
    scan.header = sensors.header(stamp_ns, frame)
    scan.angle_min += scan.angle_increment * beams.start
    scan.ranges = scan.ranges[beams]
    scan.angle_max = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
    return topic, kind, log_ns + later_ns, sensors.packed(scan, kind)


@pytest.fixture(scope="module")
def better(
    office: list[Row], sensors: ModuleType, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, float]:
    """How well the better one of the two sectors does alone."""
    found = []
    for beams in (LEFT, RIGHT):
        rows = [
            _part(sensors, kind, t, raw, ("/scan", "laser", beams, 0))
            if topic == "/scan"
            else (topic, kind, t, raw)
            for topic, kind, t, raw in office
        ]
        run = read_run(sensors.mcap(tmp_path_factory.mktemp("alone") / "log.mcap", rows))
        found.append(run.source["junctions"])
    return {
        "covered": max(told["covered"] for told in found),
        "drift_after_m": min(told["drift_after_m"] for told in found),
    }


@pytest.mark.parametrize(
    "sectors",
    [
        [("/a", "l", RIGHT, 0), ("/b", "r", LEFT, 10**6)],
        [("/a", "laser", LEFT, 0), ("/b", "laser", RIGHT, 0)],
        [("/scan", "laser", LEFT, 10**6), ("/scan", "laser", RIGHT, 0)],
    ],
    ids=["right first", "one frame", "one laser"],
)
def test_two_lasers_are_no_worse_than_the_better_one(
    read: Callable[..., tuple[Path, Run]], better: dict[str, float], sectors: Sectors
) -> None:
    log, run = read(sectors)
    told = run.source["junctions"]
    assert run.warnings == ()
    topics = sorted({topic for topic, _, _, _ in sectors})
    assert sorted(told.get("lasers", [told["topic"]])) == topics
    assert told["scans"] == told["messages"]
    assert len(build_map(run)) == JUNCTIONS
    assert told["covered"] >= better["covered"] - 0.01
    assert told["drift_after_m"] <= better["drift_after_m"] + 0.03
    uses = {topic.topic: topic.use for topic in as_read(inspect_log(log), run.source).topics}
    assert {uses[topic] for topic in topics} == {"scans"}


def test_a_filtered_copy_is_left_out_and_named(read: Callable[..., tuple[Path, Run]]) -> None:
    copy = [("/scan", "laser", slice(0, 120), 0), ("/scan_filtered", "laser", slice(20, 100), 0)]
    log, run = read(copy)
    assert "lasers" not in run.source["junctions"]
    uses = {t.topic: (t.use, t.why) for t in as_read(inspect_log(log), run.source).topics}
    assert uses["/scan"][0] == "scans"
    assert uses["/scan_filtered"] == (
        "",
        "not used: /scan sees all of its directions in the same frame",
    )
