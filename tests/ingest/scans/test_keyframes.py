"""Rasters of beams, the order of keyframes, and the checks of a batch."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.keyframes import KEYFRAMES, in_order, keyframes, raster
from topobatch.ingest.scans.matching import posed
from topobatch.ingest.scans.scan import ScanBatch

from .building import RING, drive, parts, scans

FINEST = KEYFRAMES.raster_rad


def test_beams_are_thinned_out_to_the_raster() -> None:
    angles = np.linspace(-1.5, 1.5, 1001)
    columns, start, step = raster(angles, FINEST)
    assert 0.5 * FINEST < step <= FINEST
    assert angles[columns] == pytest.approx(start + step * np.arange(len(columns)))
    assert len(raster(angles[::10], FINEST)[0]) == 101


def test_keyframes_of_two_lasers_come_by_time() -> None:
    truth = drive((0, 0), (8, 0))
    front, back = scans(RING, truth), scans(RING, truth, mount=np.array([-0.3, 0.0, np.pi]))
    mixed = [b for pair in zip(parts(front, 7), parts(back, 7), strict=True) for b in pair]
    chunks = list(in_order(keyframes(posed(truth, mixed)), 10))
    assert all(len(chunk) == 10 for chunk in chunks[:-1])
    times = np.concatenate([chunk.time_ns for chunk in chunks])
    assert (np.diff(times) >= 0).all()
    single = sum(len(k) for k in keyframes(posed(truth, [front])))
    assert len(times) == 2 * single


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ranges_m": np.ones((3, 5), np.float32)}, "shape"),
        ({"ranges_m": np.full((3, 4), np.inf, np.float32)}, "neither positive nor NaN"),
        ({"ranges_m": np.zeros((3, 4), np.float32)}, "neither positive nor NaN"),
        ({"times_ns": np.array([3, 2, 1])}, "order of time"),
        ({"free_m": -1.0}, "not negative"),
        ({"sweep_s": np.nan}, "finite"),
        ({"angles_rad": np.array([0.0, np.nan, 1.0, 2.0])}, "not finite"),
    ],
)
def test_batches_are_checked_at_birth(change: dict[str, object], message: str) -> None:
    good = {
        "times_ns": np.array([1, 2, 3]),
        "ranges_m": np.ones((3, 4), np.float32),
        "free_m": 0.0,
        "angles_rad": np.linspace(-1, 1, 4),
    }
    ScanBatch(**good)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=message):
        ScanBatch(**(good | change))  # type: ignore[arg-type]
