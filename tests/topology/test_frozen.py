"""Arrays are checked at birth and cannot change."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.frozen import frozen_array


def test_frozen_array_does_not_follow_its_source():
    source = np.arange(6.0).reshape(3, 2)
    frozen = frozen_array(source, np.float64, (3, 2), "x")
    source[0, 0] = 99
    assert frozen[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        frozen[0, 0] = 1
    assert source.flags.writeable


def test_frozen_array_refuses():
    with pytest.raises(ValueError, match="shape"):
        frozen_array(np.zeros((3, 2)), np.float64, (None, 3), "x")
    with pytest.raises(ValueError, match="finite"):
        frozen_array([1.0, np.inf], np.float64, (None,), "x")
    with pytest.raises(ValueError, match="fractions"):
        frozen_array([1.5], np.int64, (None,), "x")
