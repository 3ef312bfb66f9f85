"""Scans that turn against the odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.ingest.scans.turns import MirroredError
from topobatch.topology.errors import DataError
from topobatch.topology.se2 import between, compose

from .building import RING, drive, scans

ROUND = drive((8, 0), (10, 0), (10, 3), (10, 0), (13, 0), (10, 0), (10, 2), (10, 0), (7, 0))


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
    with pytest.raises(DataError, match="do not turn when the odometry does"):
        detect(replace(ROUND, pose=np.array(pose)), [scans(RING, ROUND)])
