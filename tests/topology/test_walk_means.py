"""Random walks seen through means, beside their covariances term by term."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from topobatch.topology.walk_means import WalkMeans


@given(st.integers(0, 2**32 - 1))
def test_means_differ_as_the_covariances_of_a_walk_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 9, 4)
    walked = np.cumsum(rng.exponential(size=(size.sum(), 2)), axis=0)
    group = np.repeat(np.arange(4), size)
    first, second = np.triu_indices(4, 1)
    found = WalkMeans.of(walked, group, 4).between(first, second)
    for k, (i, j) in enumerate(zip(first, second, strict=True)):
        share = (group == j) / size[j] - (group == i) / size[i]
        for walk in (0, 1):
            c = walked[:, walk]
            np.testing.assert_allclose(found[k, walk], share @ np.minimum.outer(c, c) @ share)
