"""Components of a graph that is given by its links."""

from __future__ import annotations

import numpy as np

from topobatch.topology.connected import connected


def test_components_are_numbered_by_their_first_nodes() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        count, links = int(rng.integers(1, 40)), int(rng.integers(0, 50))
        one, other = rng.integers(0, count, (2, links))
        found = connected(one, other, count)
        assert (found[one] == found[other]).all()
        _, first = np.unique(found, return_index=True)
        assert (np.diff(first) > 0).all()
        assert found.max() + 1 == len(first) >= count - links
