"""Scans that turn against the odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.handedness import ENOUGH, MirroredError, Turns
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.topology.errors import DataError
from topobatch.topology.se2 import between, compose

from .building import RING, drive, scans

ROUND = drive((8, 0), (10, 0), (10, 3), (10, 0), (13, 0), (10, 0), (10, 2), (10, 0), (7, 0))


def poses(*turns: float) -> np.ndarray:
    return np.column_stack([np.zeros((len(turns) + 1, 2)), np.cumsum([0.0, *turns])])


def test_only_turns_by_both_accounts_are_counted() -> None:
    odometry, matched = poses(0.1, 0.1, 0.1, -0.1, 0.02), poses(0.1, -0.1, 0.02, -0.1, 0.1)
    piece = np.zeros(6, np.int64)
    assert Turns().more(odometry, matched, piece) == Turns(2, 1)
    # What lies between pieces of odometry is no step.
    assert Turns(3, 4).more(odometry, matched, np.arange(6)) == Turns(3, 4)


@pytest.mark.parametrize(
    ("turns", "mirrored", "unlike"),
    [
        (Turns(0, ENOUGH), True, False),
        (Turns(ENOUGH, 0), False, False),
        (Turns(ENOUGH, ENOUGH), False, True),
        (Turns(0, ENOUGH - 1), False, False),
    ],
)
def test_a_few_turns_tell_nothing(turns: Turns, mirrored: bool, unlike: bool) -> None:
    assert (turns.mirrored, turns.unlike) == (mirrored, unlike)


def mirrored() -> ScanBatch:
    seen = scans(RING, ROUND)
    return replace(seen, ranges_m=seen.ranges_m[:, ::-1])


def test_mirror_images_are_told() -> None:
    with pytest.raises(MirroredError, match="turn against the odometry at"):
        detect(ROUND, [mirrored()])
    # Nothing tells without odometry.
    assert not detect(None, [mirrored()]).statistics.odometry


def test_what_fits_neither_way_up_is_refused() -> None:
    step = between(ROUND.pose[:-1], ROUND.pose[1:])
    corner = np.cumsum(np.diff(np.abs(step[:, 2]) > 0.05, prepend=0) > 0)
    step[:, 2] *= np.where(corner % 2, 1, -1)
    pose = [ROUND.pose[0]]
    for each in step:
        pose.append(compose(pose[-1], each))
    with pytest.raises(DataError, match="neither those of a laser upright nor upside down"):
        detect(replace(ROUND, pose=np.array(pose)), [scans(RING, ROUND)])
