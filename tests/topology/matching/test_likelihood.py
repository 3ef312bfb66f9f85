"""The terms of the likelihood that closure, robust merging and the paper's method share."""

import numpy as np
import pytest
from scipy.stats import chi2

from topobatch.topology.matching.likelihood import (
    LIKELIHOOD,
    doubted,
    length_log_density,
    log_density,
    rarity,
)


def test_differences_of_one_thing_have_a_density_with_heavy_tails():
    d = np.linspace(-20, 20, 40_001)
    variance = np.full(len(d), 0.04)
    density = np.exp(length_log_density(d, variance))
    assert np.trapezoid(density, d) == pytest.approx(1.0, abs=1e-6)
    normal = -0.5 * 2.0**2 / 0.04
    assert length_log_density(np.array([2.0]), np.array([0.04]))[0] > normal + 14
    assert log_density(d**2 / 0.04, variance) == pytest.approx(np.log(density))


def test_what_is_common_is_worth_little():
    many, few = np.full(95, 5.03), np.full(5, 12.03)
    worth = rarity(np.concatenate([many, few]))
    assert worth[-1] - worth[0] == pytest.approx(np.log(95 / 5), abs=0.1)
    # The histogram's peak: a triangle as wide as its kernel, less the share of outliers.
    peak = LIKELIHOOD.cells_per_m / LIKELIHOOD.kernel_cells
    assert worth[0] == pytest.approx(-np.log(0.95 * 0.95 * peak), abs=0.01)
    assert len(rarity(np.zeros(0))) == 0


def test_a_look_in_doubt_tells_less_for_and_against():
    told, sure = np.array([6.0, -6.0, 3.0, -3.0]), np.log([0.5, 0.5, 1.0, 1e-9])
    mixed = np.log(np.exp(sure) * np.exp(told) + 1 - np.exp(sure))
    assert doubted(told, sure) == pytest.approx(mixed)
    assert doubted(told, sure)[2] == 3.0
    assert doubted(told, sure)[1] == pytest.approx(np.log(0.5), abs=0.01)


def test_one_gate_lets_by_as_many_errors_of_any_dimension():
    assert LIKELIHOOD.gate_chi2(1) == pytest.approx(LIKELIHOOD.gate_sigmas**2)
    for freedom in (2, 3, 60):
        assert chi2.sf(LIKELIHOOD.gate_chi2(freedom), freedom) == pytest.approx(0.0027, rel=1e-3)
