"""Rasters of beams, the order of keyframes, and the checks of a batch."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.keyframes import raster
from topobatch.ingest.scans.scan import ScanBatch


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


def test_beams_that_all_look_one_way_are_one() -> None:
    columns, first, step = raster(np.full(5, 0.3), 0.01)
    assert (len(columns), first, step) == (1, 0.3, 0.01)
