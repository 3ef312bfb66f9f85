"""Passes are checked at birth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.passes import Passes
from topobatch.topology.ragged import Ragged


def some_passes() -> Passes:
    branches = Ragged.from_rows([[-1.0, 2.0], [0.5]])
    return Passes(
        time_ns=[10, 20],
        start_ns=[9, 19],
        end_ns=[11, 21],
        centre=np.zeros((2, 2)),
        branches=branches,
        support=Ragged.from_rows([[1.0, 1.0], [1.0]]),
        entry=[-1, 0],
        exit=[1, 0],
        messages=[3, 3],
        confidence=[1.0, 1.0],
    )


def test_passes_check_their_branches():
    good = some_passes()
    with pytest.raises(ValueError, match="exit"):
        replace(good, exit=np.array([1, 1]))
    with pytest.raises(ValueError, match="support"):
        replace(good, support=Ragged.from_rows([[1.0], [1.0]]))
    with pytest.raises(ValueError, match="order"):
        replace(good, time_ns=np.array([20, 10]))
