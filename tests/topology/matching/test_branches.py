"""Branches that are each other's nearest, and what they tell."""

import numpy as np
import pytest

from topobatch.topology.matching.branches import agreeing, mutual_nearest
from topobatch.topology.matching.likelihood import LIKELIHOOD, log_density
from topobatch.topology.se2 import wrap


def units(rng, k, d):
    """Headings and the same as unit numbers; rows end with no branches."""
    angle = rng.uniform(-np.pi, np.pi, (k, d))
    angle[np.arange(d) >= rng.integers(0, d + 1, k)[:, None]] = np.nan
    return angle, np.where(np.isfinite(angle), np.exp(1j * np.nan_to_num(angle)), 0.0)


def test_pairs_are_those_of_brute_force():
    rng = np.random.default_rng(0)
    (angle_a, unit_a), (angle_b, unit_b) = units(rng, 200, 4), units(rng, 200, 5)
    pairs = mutual_nearest(unit_a, unit_b)
    off = np.abs(wrap(angle_a[:, :, None] - angle_b[:, None, :]))
    off[np.isnan(off)] = np.inf
    for row in range(200):
        for i in range(4):
            j = int(off[row, i].argmin())
            same = off[row, i, j] < LIKELIHOOD.branch_gate_rad and off[row, :, j].argmin() == i
            assert pairs.paired[row, i] == same
            if same:
                assert pairs.nearest[row, i] == j
                assert pairs.chord2[row, i] == pytest.approx(4 * np.sin(off[row, i, j] / 2) ** 2)


def test_paired_branches_tell_by_how_near_and_how_free_they_are():
    a = np.exp(1j * np.array([[0.0, 1.5, 3.0]]))
    b = np.exp(1j * np.array([[0.1, 1.5]]))
    pairs = mutual_nearest(a, b)
    assert pairs.paired.tolist() == [[True, True, False]]
    variance, free = np.array([0.01]), np.array([[1.0, 2.0, 50.0]])
    fit = log_density(pairs.chord2 / 0.01, np.full((1, 3), 0.01))[0]
    told = agreeing(pairs, variance, free, np.inf)
    assert told == pytest.approx(fit[0] + 1.0 + fit[1] + 2.0)
    assert agreeing(pairs, variance, free, 0.5) == pytest.approx(1.0)
