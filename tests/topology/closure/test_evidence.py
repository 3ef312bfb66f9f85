"""What position and lengths tell of two places being one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from topobatch.topology.closure.evidence import (
    Background,
    length_odds,
    position_odds,
)
from topobatch.topology.matching.likelihood import Lengths

COMMON = Background(
    leg_m=6.0,
    core_m=2.0,
    reach_m=0.5,
    lengths=Lengths.of(np.repeat([5.0, 9.0], [19, 1])),
    branch_sigma=0.05,
    centre_sigma=0.1,
    fault_rate=0.02,
    miss_rate=0.02,
)


def test_far_from_the_core_position_is_told_against_places_anywhere():
    shift = np.array([[7.0, 0.0], [0.0, -9.0]])
    cov = np.array([np.diag([4.0, 1.0]), [[3.0, 1.0], [1.0, 2.0]]])
    odds, d2 = position_odds(COMMON, shift, cov)
    for k in (0, 1):
        same = multivariate_normal.logpdf(shift[k], cov=cov[k])
        assert odds[k] == pytest.approx(same - np.log(1 / 6.0**2), abs=0.05)
        assert d2[k] == pytest.approx(shift[k] @ np.linalg.inv(cov[k]) @ shift[k])


def test_within_the_core_hardly_another_junction_is_expected():
    near, far = position_odds(
        COMMON, np.zeros((2, 2)), np.array([0.01, 25.0])[:, None, None] * np.eye(2)
    )[0]
    plain = -np.log(2 * np.pi * 0.01) + 2 * np.log(6.0)
    assert near > plain + 4
    # Where it is not known whether it is the core, that is worth nothing.
    assert far == pytest.approx(-np.log(2 * np.pi * 25.0) + 2 * np.log(6.0), abs=0.1)


def test_equal_lengths_tell_the_more_the_rarer_they_are():
    a, b = np.array([5.0, 9.0, 5.0]), np.array([5.0, 9.0, 6.0])
    often, rare, other = length_odds(COMMON, a, b, np.full(3, 0.01))
    assert rare - often == pytest.approx(np.log(19), abs=0.2)
    assert other < 0 < often
