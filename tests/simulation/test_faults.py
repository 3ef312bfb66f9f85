"""Rates of faults."""

from __future__ import annotations

import pytest

from topobatch.simulation import Faults
from topobatch.topology.errors import UsageError


@pytest.mark.parametrize("wrong", [{"centre_m": -1.0}, {"phantom_rate": 1.5}])
def test_nonsensical_faults_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="faults"):
        Faults(**wrong)
