"""What foxglove's messages hold."""

import numpy as np
import pytest

from topobatch.ingest.logs.foxglove import unit_quaternion
from topobatch.ingest.logs.messages import DamageError


@pytest.mark.parametrize("length", [1e-5, 0.5, 1.0, 1e5])
def test_quaternions_of_any_sensible_length_are_taken(length: float) -> None:
    turn = tuple((length * np.array([0.0, 0.0, 0.6, 0.8])).tolist())
    assert unit_quaternion(turn) == pytest.approx((0.0, 0.0, 0.6, 0.8))


def test_a_quaternion_of_zeros_is_no_turn() -> None:
    assert unit_quaternion((0.0, -0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("damaged", [5e-324, 1e-160, 1e7, 1e200, np.inf, np.nan])
def test_other_bytes_are_no_quaternion(damaged: float) -> None:
    """Squares of the smallest numbers are zero, and those of the largest infinite."""
    with pytest.raises(DamageError, match="implausible length"):
        unit_quaternion((0.0, damaged, 0.0, 0.0))
