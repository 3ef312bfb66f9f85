"""Tables of arrays with one row for each thing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topobatch.topology.columns import columns_and, columns_of, joined, take
from topobatch.topology.ragged import Ragged


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


@dataclass(frozen=True)
class Told:
    """Columns of every kind."""

    name: NDArray[np.int64]
    branches: Ragged
    kind: tuple[str, ...]
    sigma: NDArray[np.float64] | None = None


TOLD = Told(np.array([3, 5]), Ragged.from_rows([[0.0, 1.0], [2.0]]), ("bend", "junction"))


def test_rows_of_every_kind_of_column_are_taken():
    for rows in (np.array([1]), np.array([False, True])):
        one = columns_of(TOLD, ("name", "branches", "kind", "sigma"), rows)
        assert (one["name"].tolist(), one["kind"], one["sigma"]) == ([5], ("junction",), None)
        assert one["branches"].values.tolist() == [2.0]


def test_more_rows_come_behind():
    more = {"branches": Ragged.from_rows([[4.0]]), "kind": ["dead_end"], "sigma": np.ones(1)}
    both = columns_and(TOLD, more)
    assert (both["kind"], both["sigma"]) == (("bend", "junction", "dead_end"), None)
    assert both["branches"].offsets.tolist() == [0, 2, 3, 4]
    assert both.keys() == more.keys()
