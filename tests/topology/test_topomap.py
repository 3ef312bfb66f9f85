"""A map is checked at birth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.ragged import Ragged

from .test_document import small_map


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"xy": np.zeros((2, 3))}, "xy"),
        ({"xy": np.array([[0.0, np.nan], [1.0, 2.0]])}, "xy"),
        ({"kind": ("junction",)}, "one branch row and kind per vertex"),
        ({"paths": (np.zeros((1, 2)),) * 3}, "two points or more"),
        ({"target": [1, 1, 2]}, "target names a vertex"),
        ({"source_branch": [1, 3, 1]}, "source_branch names a branch"),
        ({"observation_vertex": [0, 1, 0, 2]}, "observation names a vertex"),
        ({"length": [4.2, 0.0, 7.0]}, "must be positive"),
        ({"position_sigma": [0.1]}, "position_sigma"),
        ({"branch_sigma": Ragged.from_rows([[0.1], [0.1]])}, "one value per branch"),
        ({"confidence": [0.5, 0.0]}, "between 0 and 1"),
        ({"traversal_ns": (np.zeros((1, 2), np.int64),)}, "one array per edge"),
    ],
)
def test_what_does_not_fit_is_refused(wrong, told):
    with pytest.raises(ValueError, match=told):
        replace(small_map(), **wrong)


def test_arrays_of_a_map_cannot_be_changed():
    m = small_map()
    for array in (m.xy, m.length, m.paths[0], m.branches.values, m.confidence):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert m.degree.tolist() == [3, 4]
    assert m.measured is m.noise
