"""A crossing that a skeleton shows as two forks."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust.atlas import Atlas
from topobatch.merge.robust.branches import branch_bits
from topobatch.merge.robust.prepare import prepare

from .plans import against, crossing_and_forks, laid


def test_a_crossing_fits_two_forks_of_a_skeleton(drawn):
    whole, forks = crossing_and_forks(drawn)
    a, plain, scans = map(prepare, (whole, forks, replace(forks, shows_bends=False)))
    one, zero = np.ones(1, complex), np.zeros(1, np.int64)
    fork, crossing, back = (
        branch_bits(x, y, zero, zero, one) for x, y in ((a, plain), (a, scans), (scans, a))
    )
    assert crossing == pytest.approx(back)
    assert fork + 2 < crossing
    for x, y in ((a, scans), (scans, a)):
        assert len(against(laid(x, y))) == 0
    assert len(against(laid(a, plain))) > 0
    together = Atlas.of([a, scans, prepare(replace(forks, run="c", shows_bends=False))])
    assert together.whole.halves.half[-6:].tolist() == (scans.halves.half + len(a) + 6).tolist()
