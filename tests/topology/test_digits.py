"""Numbers to the digits that they mean."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.digits import METRES, rounded, significant


@pytest.mark.parametrize("value", [1.23449, -1.23451, 0.0005, -0.0004, 2.5e8, 1e12])
def test_one_number_is_rounded_as_in_an_array(value):
    assert rounded(value, METRES) == rounded(np.array([value]), METRES)[0] == np.round(value, 3)


def test_there_is_one_zero():
    assert str(rounded(-0.0001, METRES)) == str(rounded([-0.0001], METRES)[0]) == "0.0"
    assert str(significant(-0.0)) == "0.0"


def test_uncertainties_have_four_digits():
    found = [significant(x) for x in (0.0123456, 123456.0, 0.0, -2.00049)]
    assert found == [0.01235, 123500.0, 0.0, -2.0]
