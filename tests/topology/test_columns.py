"""Tables of arrays with one row for each thing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topobatch.topology.columns import joined, take


@dataclass(frozen=True)
class Place:
    name: NDArray[np.int64]
    xy: NDArray[np.float64]


TABLE = Place(np.array([3, 5, 8]), np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]))


def test_rows_are_taken_by_number_or_mask():
    for rows in (np.array([2, 0]), np.array([True, False, True])):
        taken = take(TABLE, rows)
        assert isinstance(taken, Place)
        assert taken.name.tolist() == TABLE.name[rows].tolist()
        assert taken.xy.tolist() == TABLE.xy[rows].tolist()


def test_tables_are_joined_row_after_row():
    parts = [take(TABLE, np.arange(2)), take(TABLE, np.array([2]))]
    assert joined(parts).name.tolist() == TABLE.name.tolist()
    assert joined(parts).xy.tolist() == TABLE.xy.tolist()
