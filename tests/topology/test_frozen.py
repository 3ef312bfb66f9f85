"""Arrays are checked at birth and cannot change."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.frozen import frozen_array, frozen_rows


def test_frozen_array_refuses():
    with pytest.raises(ValueError, match="shape"):
        frozen_array(np.zeros((3, 2)), np.float64, (None, 3), "x")
    with pytest.raises(ValueError, match="finite"):
        frozen_array([1.0, np.inf], np.float64, (None,), "x")
    with pytest.raises(ValueError, match="fractions"):
        frozen_array([1.5], np.int64, (None,), "x")


def test_frozen_rows_are_checked_together_and_do_not_follow_their_sources():
    source = np.arange(6.0).reshape(3, 2)
    short, long = frozen_rows([np.array([(7, 8)]), source], np.float64, 2, "path")
    source[0, 0] = 99
    assert short.tolist() == [[7, 8]]
    assert long.tolist() == [[0, 1], [2, 3], [4, 5]]
    assert not long.flags.writeable
    assert frozen_rows([], np.float64, 2, "path") == ()
    with pytest.raises(ValueError, match=r"path has shape \(3,\)"):
        frozen_rows([np.zeros((2, 2)), np.zeros(3)], np.float64, 2, "path")
    with pytest.raises(ValueError, match="finite"):
        frozen_rows([np.zeros((2, 2)), [(np.nan, 0.0)]], np.float64, 2, "path")
    with pytest.raises(ValueError, match="fractions"):
        frozen_rows([[(1, 2)], [(0.5, 1.0)]], np.int64, 2, "times")
