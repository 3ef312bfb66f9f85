"""The nearest of many places."""

import numpy as np
import pytest

from topobatch.merge.robust.nearest_neighbours import NearestNeighbours
from topobatch.merge.robust.settings import MATCH


@pytest.mark.parametrize("n", [1, 40, 900])
def test_points_find_the_nearest_both_ways(n):
    rng = np.random.default_rng(n)
    z, where = (
        (rng.uniform(0, 40, (k, 2)) + 3e5) @ np.array([1, 1j])
        for k in (n, MATCH.most_pairs // n + 1)
    )
    points = NearestNeighbours.of(z)
    for asked in (where, where[: MATCH.most_pairs // n]):
        gap, index = points.nearest(asked, 3.0)
        all_gaps = np.abs(asked[:, None] - z)
        near = all_gaps.min(axis=1) < 3.0
        assert (index[near] == all_gaps.argmin(axis=1)[near]).all()
        assert gap[near] == pytest.approx(all_gaps.min(axis=1)[near], abs=1e-9)
        assert (gap[~near] >= 3.0).all()


def test_no_points_are_near_nothing():
    gap, _ = NearestNeighbours.of(np.zeros(0, complex)).nearest(np.array([1j, 2.0]), 5.0)
    assert np.isinf(gap).all()
