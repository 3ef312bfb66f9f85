"""Logs in which detections and odometry mean different things, and logs in which all is well."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from topobatch.ingest.odometry.conventions import disagreements
from topobatch.ingest.odometry.stationary import DriveBys
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections
from topobatch.topology.se2 import apply, inverse, wrap

Log = tuple[Odometry, Detections]


@cache
def log(world: str = "maze", drift: str = "mid", faults: str = "mild", **others: float) -> Log:
    """The odometry and detections of a simulated run."""
    settings = ScenarioSettings(
        world=world, runs=1, junctions_per_run=30, drift=drift, faults=faults, seed=7, **others
    )
    run = simulate_scenario(settings).runs["run1"]
    return run.odometry, run.detections


def told(odometry: Odometry, detections: Detections) -> list[str]:
    return disagreements(odometry, detections, "/odom", "/junctions")


def positions(to: float | list[float]) -> Log:
    odometry, detections = log()
    return odometry, replace(detections, centre=detections.centre * to)


def headings(seen: Detections, factor: float, turn: np.ndarray | float = 0.0) -> Detections:
    branches = seen.branches
    values = factor * branches.values + np.broadcast_to(turn, len(seen))[branches.owner]
    return replace(seen, branches=Ragged(branches.offsets, wrap(values)))


def yaw(factor: float, to: str = "unwrapped") -> Log:
    odometry, detections = log(odometry_hz=100)
    heading = odometry.pose[:, 2]
    heading = factor * (np.unwrap(heading) if to == "unwrapped" else heading)
    return replace(
        odometry, pose=np.column_stack([odometry.pose[:, :2], wrap(heading)])
    ), detections


def late(by_s: float) -> Log:
    odometry, detections = log()
    return odometry, replace(detections, time_ns=detections.time_ns + round(by_s * 1e9))


def in_odometry_frame(log: Log) -> Log:
    """Detections in the frame of the odometry that say that they are in the robot's."""
    odometry, seen = log
    pose = odometry.at(seen.time_ns)
    return odometry, headings(replace(seen, centre=apply(pose, seen.centre)), 1.0, pose[:, 2])


def clockwise() -> Log:
    odometry, detections = log()
    return odometry, headings(detections, -1.0)


def not_turned() -> Log:
    odometry, detections = log()
    return odometry, headings(detections, 1.0, odometry.at(detections.time_ns)[:, 2])


def quarter_turn() -> Log:
    odometry, detections = log()
    return odometry, replace(detections, centre=detections.centre[:, ::-1] * [-1, 1])


def odometry_turned(by_rad: float, driven_rad: float = 0.0) -> Log:
    """Headings of the odometry turned, of a robot that drives turned (both with the detector)."""
    odometry, detections = log()
    turned = np.append(np.zeros(2), by_rad + driven_rad)
    seen = apply(np.append(np.zeros(2), -driven_rad), detections.centre)
    branches = headings(detections, 1.0, -driven_rad).branches
    return replace(odometry, pose=odometry.pose + turned), replace(
        detections, centre=seen, branches=branches
    )


def odometry_in(per_m: float) -> Log:
    odometry, detections = log()
    return replace(odometry, pose=odometry.pose * [per_m, per_m, 1]), detections


MISREAD = {
    "millimetres": (lambda: positions(1000), "their positions are 0.00", "length=mm"),
    "centimetres": (lambda: positions(100), "their positions are 0.0", "in centimetres?"),
    "odometry in feet": (lambda: odometry_in(1 / 0.3048), "positions of /odom are 0.3", "in feet?"),
    "odometry in centimetres": (
        lambda: odometry_in(100),
        "positions of /odom are 0.0",
        "centimetres?",
    ),
    "no unit": (lambda: positions(9), "their positions are 0.11", "in another unit?"),
    "y to the right": (lambda: positions([1, -1]), "the y axis of their positions", "to the left"),
    "no transform": (quarter_turn, "the frame of their positions is turned by", "/tf_static"),
    "odometry turned": (
        lambda: odometry_turned(np.pi / 2),
        "headings of /odom are turned by 90",
        "mend its quaternions",
    ),
    "odometry turned round": (
        lambda: odometry_turned(np.pi),
        "headings of /odom are turned by 180",
        "mend its quaternions",
    ),
    "late": (lambda: late(3.0), "they are stamped 3 s (± 0.25 s) late beside /odom", "--time log"),
    "early": (lambda: late(-5.0), "they are stamped 5 s (± 0.25 s) early beside", "stamp="),
    "yaw in degrees": (lambda: yaw(180 / np.pi), "headings of /odom are 1/57.3", "degrees taken"),
    "yaw in ±180 degrees": (lambda: yaw(180 / np.pi, "wrapped"), "of /odom are 1/57.3", "degrees"),
    "yaw converted twice": (lambda: yaw(np.pi / 180), "/odom are 57.3 times", "radians taken"),
    "clockwise yaw": (lambda: yaw(-1), "headings of /odom run the other way", "counter-clockwise"),
    "no yaw": (lambda: yaw(0), "headings of /odom are those in which it moves", "quaternions"),
    "clockwise branches": (clockwise, "branches of /junctions", "run the other way"),
    "branches not turned": (not_turned, "branches of /junctions", "a frame fixed to the world"),
    "another frame": (lambda: in_odometry_frame(log()), "junctions of /junctions", "fixed to the"),
}


@pytest.mark.parametrize("name", MISREAD)
def test_what_is_misread_is_told(name: str) -> None:
    make, finding, advice = MISREAD[name]
    (sentence,) = told(*make())
    assert finding in sentence
    assert advice in sentence
    assert sentence.endswith("; see docs/detections.md")


@pytest.mark.parametrize("world", ["maze", "organic", "rows"])
@pytest.mark.parametrize(("drift", "faults"), [("none", "none"), ("high", "harsh")])
def test_good_logs_are_silent(world: str, drift: str, faults: str) -> None:
    assert told(*log(world, drift, faults)) == []


@pytest.mark.parametrize("world", ["maze", "organic"])
@pytest.mark.parametrize("lever_m", [(-1.0, 0.0), (0.4, -0.3)])
def test_a_detector_that_sits_elsewhere_is_not_late(
    world: str, lever_m: tuple[float, float]
) -> None:
    odometry, detections = log(world)
    assert told(odometry, detections.moved(lever_m)) == []


def test_few_drive_bys_tell_nothing() -> None:
    odometry, detections = positions(1000)
    first = np.arange(20)
    few = Detections(
        detections.time_ns[first], detections.centre[first], detections.branches.take(first)
    )
    assert 0 < len(DriveBys.of(odometry, few)) < 5
    assert told(odometry, few) == []


def claims_odometry(log: Log) -> Log:
    """Detections in the robot's frame whose header claims the odometry's, as they are read."""
    odometry, seen = log
    pose = odometry.at(seen.time_ns)
    return odometry, headings(
        replace(seen, centre=apply(inverse(pose), seen.centre)), 1.0, -pose[:, 2]
    )


@pytest.mark.parametrize("world", ["maze", "organic"])
def test_detections_of_the_robots_frame_that_claim_the_odometrys_are_told(world: str) -> None:
    (sentence,) = told(*claims_odometry(log(world)))
    assert "their positions are in the robot's frame, not in the odometry's" in sentence
