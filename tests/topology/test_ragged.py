"""Rows of unequal length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from topobatch.topology.ragged import Ragged

rows = st.lists(st.lists(st.floats(-10, 10), max_size=4), max_size=8)


@given(rows)
def test_ragged_gives_back_its_rows(lists):
    ragged = Ragged.from_rows(lists)
    assert [ragged[i].tolist() for i in range(len(ragged))] == lists
    assert ragged.owner.tolist() == [i for i, row in enumerate(lists) for _ in row]


@given(rows, st.data())
def test_ragged_take(lists, data):
    pick = data.draw(st.lists(st.integers(0, len(lists) - 1), max_size=6)) if lists else []
    taken = Ragged.from_rows(lists).take(pick)
    assert [taken[i].tolist() for i in range(len(taken))] == [lists[i] for i in pick]


@pytest.mark.parametrize(
    ("offsets", "values"),
    [([0, 1], [1.0, 2.0]), ([1, 2], [1.0, 2.0]), ([0, 2, 1, 2], [1.0, 2.0]), ([0, 1], [np.nan])],
)
def test_ragged_refuses_nonsense(offsets, values):
    with pytest.raises(ValueError, match=r"offsets|finite"):
        Ragged(np.array(offsets), np.array(values))
