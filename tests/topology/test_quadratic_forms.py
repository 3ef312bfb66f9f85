"""Quantiles of quadratic forms against what is known exactly and against samples."""

import numpy as np
import pytest
from scipy.stats import chi2

from topobatch.topology.quadratic_forms import ONE_SIGMA, quadratic_quantile

SHARES = (ONE_SIGMA, 0.95, 0.9973)


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("share", SHARES)
def test_axes_that_err_alike_have_a_chi_square(axes, share):
    (found,) = quadratic_quantile(0.04 * np.eye(3)[None] * (np.arange(3) < axes), share)
    assert found == pytest.approx(0.04 * chi2.ppf(share, axes), rel=1e-9)


@pytest.mark.parametrize("share", SHARES)
def test_axes_that_err_unlike_hold_their_share_of_samples(share):
    rng = np.random.default_rng(5)
    roots = rng.normal(size=(12, 3, 3)) * rng.uniform(0.05, 1.0, size=(12, 1, 3))
    form = np.diag([1.0, 1.0, 0.2])
    limit = quadratic_quantile(roots @ roots.transpose(0, 2, 1) @ form, share)
    x = roots @ rng.normal(size=(3, 100_000))
    held = np.mean(np.einsum("kis,ij,kjs->ks", x, form, x) <= limit[:, None], axis=1)
    np.testing.assert_allclose(held, share, atol=0.012)


def test_what_is_known_exactly_is_off_by_nothing():
    np.testing.assert_array_equal(quadratic_quantile(np.zeros((2, 3, 3)), ONE_SIGMA), 0.0)
