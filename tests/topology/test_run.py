"""Runs: sightings and passes are in the order of time, with a row of branches each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections, ScanPasses

BRANCHES = Ragged.from_rows([[0.0, 1.5], [3.0]])
SEEN = Detections(np.array([10, 20]), np.zeros((2, 2)), BRANCHES)
PASSES = ScanPasses(
    *(np.array([10, 20]) for _ in range(3)),
    np.zeros((2, 2)),
    BRANCHES,
    Ragged.from_rows([[1.0, 0.5], [1.0]]),
    np.ones(2),
    np.ones(2, np.int64),
    np.ones(2),
    np.zeros(2),
)


@pytest.mark.parametrize("value", [SEEN, PASSES])
def test_rows_are_in_the_order_of_time(value) -> None:
    assert len(value) == 2
    with pytest.raises(ValueError, match="order of time"):
        replace(value, time_ns=np.array([20, 10]))
    with pytest.raises(ValueError, match="shape"):
        replace(value, centre=np.zeros((2, 3)))


def test_every_row_has_its_branches() -> None:
    with pytest.raises(ValueError, match="one row of branches"):
        replace(SEEN, branches=Ragged.from_rows([[0.0]]))
    with pytest.raises(ValueError, match="of equal lengths"):
        replace(PASSES, support=Ragged.from_rows([[1.0], [1.0, 0.5]]))
