"""A crossing that a skeleton shows as two forks."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust.atlas import Atlas
from topobatch.merge.robust.branches import branch_bits
from topobatch.merge.robust.prepare import prepare
from topobatch.topology.se2 import wrap

from .plans import against, crossing_and_forks, laid


def test_two_forks_close_by_are_halves_of_a_crossing(drawn):
    whole, forks = crossing_and_forks(drawn)
    scans = prepare(replace(forks, shows_bends=False))
    assert scans.halves.half.tolist() == [5, 1, 2, 3, 4, 0]
    ways = np.sort(np.angle(scans.halves.unit[[0, 5]]), axis=1)
    assert np.abs(wrap(ways - np.radians([-140, 0, 40, 180]))).max() < 0.1
    assert not scans.halves.unit[1:5].any()
    # Detectors tell crossings from forks, and forks farther apart are two.
    far = replace(crossing_and_forks(drawn, 2.0)[1], shows_bends=False)
    for other in (forks, far, replace(whole, shows_bends=False)):
        m = prepare(other)
        assert m.halves.half.tolist() == list(range(len(m)))


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
