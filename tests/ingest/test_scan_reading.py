"""Runs read from scans: with an odometry, with one that is none, and with another clock's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from topobatch.ingest.inspection import as_read
from topobatch.ingest.reading import inspect_log, read_run
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import LaserSettings, ScenarioSettings
from topobatch.simulation.writing import write_run

LASER = LaserSettings(beams=120, rate_hz=4.0, door_share=0.0, people_per_100_m=0.0)
Row = tuple[str, str, int, bytes]


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    """The messages of a run with a laser."""
    settings = ScenarioSettings(
        "office", runs=1, junctions_per_run=6, laser=LASER, tells_junctions=False, seed=3
    )
    log = write_run(tmp_path_factory.mktemp("office"), simulate_scenario(settings).simulated[0])
    with AnyReader([log]) as reader:
        return [(c.topic, c.msgtype, t, bytes(raw)) for c, t, raw in reader.messages()]


def changed(
    office: list[Row], sensors: ModuleType, path: Path, topic: str, change: Callable[[Any], object]
) -> Path:
    """The log with the messages of a topic changed."""

    def of(row: Row) -> Row:
        if row[0] != topic:
            return row
        message = sensors.ROS2.deserialize_cdr(row[3], row[1])
        change(message)
        return (*row[:3], sensors.packed(message, row[1]))

    return sensors.mcap(path, [of(row) for row in office])


def test_an_odometry_that_never_moves_is_left_out(
    office: list[Row], sensors: ModuleType, tmp_path: Path
) -> None:
    def stands(message: Any) -> None:
        message.pose.pose.position.x = message.pose.pose.position.y = 0.0

    log = changed(office, sensors, tmp_path / "stands.mcap", "/odom", stands)
    run = read_run(log)
    assert run.warnings[0] == (
        "/odom: never moves, but the scans do; left out: each scan was matched to the one before"
    )
    alone = read_run(sensors.mcap(tmp_path / "alone.mcap", [r for r in office if r[0] != "/odom"]))
    way = alone.odometry.step_m.sum()
    assert run.odometry.step_m.sum() == pytest.approx(way, rel=0.01)
    uses = {topic.topic: topic.why for topic in as_read(inspect_log(log), run.source).topics}
    assert uses["/odom"] == "not used: never moves, but the scans do"
