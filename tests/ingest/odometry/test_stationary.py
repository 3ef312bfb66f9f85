"""Exact detections of junctions along an exact track: every reading is fitted as it was made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.odometry.stationary import AS_READ, DRIVE_BYS, DriveBys, Reading
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections
from topobatch.topology.se2 import apply, inverse, wrap

SECOND_NS = 10**9
JUNCTIONS = np.array([[2.0, 0.3], [6.0, -0.4], [10.0, 0.2]])
BRANCHES = np.array([0.1, 1.7, -2.4])


def drive() -> tuple[Odometry, Detections]:
    """A winding drive past three junctions, each seen ten times a second while nearer than 1 m."""
    time_s = np.arange(0, 24, 0.02)
    pose = np.column_stack([0.5 * time_s, 0.3 * np.sin(2 * time_s), 0.8 * np.cos(2 * time_s)])
    time_ns = (time_s * SECOND_NS).astype(np.int64)
    odometry = Odometry(time_ns, pose, np.zeros(0, np.int64))
    tenth = range(0, len(pose), 5)
    seen = [(k, m) for k in tenth for m in JUNCTIONS if abs(m[0] - pose[k, 0]) < 1]
    rows = [k for k, _ in seen]
    centre = np.array([apply(inverse(pose[k]), m) for k, m in seen])
    branches = Ragged.from_rows([wrap(BRANCHES - pose[k, 2]) for k in rows])
    return odometry, Detections(time_ns[rows], centre, branches)


def test_every_junction_is_one_drive_by_and_stays() -> None:
    seen = DriveBys.of(*drive())
    assert len(seen) == len(JUNCTIONS)
    fit = seen.fit(AS_READ)
    assert fit.slope == pytest.approx(1.0)
    assert fit.squares == pytest.approx(np.zeros(3), abs=1e-9)
    assert (fit.still > 1.0).all()
    assert (seen.fit(AS_READ, 0.9).squares > 0.01).all()
    assert seen.headings(AS_READ) == pytest.approx(np.zeros(3), abs=1e-12)
    assert (seen.headings(AS_READ, -1) > seen.headings(AS_READ, 0)).all()


@pytest.mark.parametrize(("scale", "turn"), [(1000.0, 0.0), (0.01, 0.0), (1.0, 1.2), (3.28, -3.0)])
def test_scale_and_turn_are_those_of_the_positions(scale: float, turn: float) -> None:
    odometry, good = drive()
    c, s = np.cos(turn), np.sin(turn)
    turned = replace(good, centre=scale * good.centre @ np.array([[c, s], [-s, c]]))
    fit = DriveBys.of(odometry, turned).fit(AS_READ)
    assert fit.slope == pytest.approx(scale * np.exp(1j * turn))
    assert fit.sigma < 1e-6 * scale


def test_readings_are_told_apart() -> None:
    odometry, good = drive()
    mirrored = replace(good, centre=good.centre * [1, -1])
    late = replace(good, time_ns=good.time_ns + 2 * SECOND_NS)
    fast = replace(odometry, pose=odometry.pose * [1, 1, 180 / np.pi])
    for track, detections, reading in (
        (odometry, mirrored, Reading(mirrored=True)),
        (odometry, late, Reading(lag_s=2.0)),
        (fast, good, Reading(yaw=np.pi / 180)),
    ):
        seen = DriveBys.of(track, detections)
        assert seen.fit(reading).squares == pytest.approx(np.zeros(3), abs=1e-9)
        assert (seen.fit(AS_READ).squares > 0.1).all()
        if not reading.mirrored:
            assert seen.headings(reading) == pytest.approx(np.zeros(3), abs=1e-9)


def test_centres_in_a_fixed_frame_stay_as_they_are() -> None:
    odometry, good = drive()
    fixed = replace(good, centre=apply(odometry.at(good.time_ns), good.centre))
    stay = DriveBys.of(odometry, fixed).in_fixed_frame()
    assert stay[:-1] == pytest.approx(np.zeros(2), abs=1e-9)
    at_the_robot = replace(good, centre=np.zeros_like(good.centre))
    assert np.isinf(DriveBys.of(odometry, at_the_robot).in_fixed_frame()).all()


def test_another_junction_is_another_drive_by_without_a_silence() -> None:
    odometry, _ = drive()
    nearest = [int(np.argmin(np.abs(JUNCTIONS[:, 0] - x))) for x in odometry.pose[:, 0]]
    centre = np.array(
        [apply(inverse(p), JUNCTIONS[m]) for p, m in zip(odometry.pose, nearest, strict=True)]
    )
    branches = Ragged.from_rows([[0.0]] * len(centre))
    for unit in (1.0, 1000.0):
        assert (
            len(DriveBys.of(odometry, Detections(odometry.time_ns, unit * centre, branches))) == 3
        )


def test_short_drive_bys_are_left_out_and_many_are_thinned() -> None:
    odometry, good = drive()
    few = np.flatnonzero(np.arange(len(good.time_ns)) % 10 == 0)
    sparse = Detections(good.time_ns[few], good.centre[few], good.branches.take(few))
    assert len(DriveBys.of(odometry, sparse)) == 0
    rounds = 2 * DRIVE_BYS.most // len(JUNCTIONS)
    long_ns = np.concatenate([good.time_ns + k * 30 * SECOND_NS for k in range(rounds)])
    many = Detections(
        long_ns, np.tile(good.centre, (rounds, 1)), Ragged.joined([good.branches] * rounds)
    )
    assert DRIVE_BYS.most / 2 < len(DriveBys.of(odometry, many)) <= DRIVE_BYS.most
    parked = Detections(
        good.time_ns[0] + 10**8 * np.arange(10_000),
        np.tile(good.centre[:1], (10_000, 1)),
        Ragged.from_rows([BRANCHES] * 10_000),
    )
    seen = DriveBys.of(odometry, parked)
    assert (len(seen), len(seen.at)) == (1, DRIVE_BYS.most_detections)
