"""Branches that are each other's nearest, and what they tell."""

import numpy as np
import pytest

from topobatch.topology.matching.branches import mutual_nearest
from topobatch.topology.matching.likelihood import LIKELIHOOD
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
