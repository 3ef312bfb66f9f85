"""Links that tell something, each once."""

import numpy as np
import pytest

from topobatch.merge.robust.support import _forest, _without_repeats


def test_a_forest_has_no_cycle_and_the_best_links():
    rng = np.random.default_rng(0)
    k = 30
    i, j = np.triu_indices(k, 1)
    bits = rng.normal(2, 2, len(i))
    chosen = _forest(i, j, bits, rng.uniform(0, 1, k))
    assert len(chosen) <= k - 1
    assert (bits[chosen] > 0).all()
    head = list(range(k))

    def root(v):
        while head[v] != v:
            v = head[v]
        return v

    for u, v in zip(i[chosen].tolist(), j[chosen].tolist(), strict=True):
        assert root(u) != root(v)
        head[root(u)] = root(v)


@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0])
def test_on_a_grid_only_the_gaps_between_lines_tell(turn):
    """Of the links of a 3 × 3 block two gaps each way are news; so the corners add no more."""
    x, y = np.meshgrid([0.0, 4.0, 10.0], [0.0, 3.0, 8.5], indexing="ij")
    grid = (x + 1j * y) * np.exp(1j * turn)
    straight = [(grid[:-1], grid[1:]), (grid[:, :-1], grid[:, 1:])]
    across = [(grid[:-1, :-1], grid[1:, 1:]), (grid[:1], grid[2:])]
    start, end = (
        np.concatenate([pair[k].reshape(-1) for pair in straight + across]) for k in (0, 1)
    )
    noise = np.random.default_rng(0).normal(0, 0.05, (2, len(start), 2)) @ [1, 1j]
    bits = np.where(np.arange(len(start)) < 12, 4.0, 3.0)
    found = sum(_without_repeats(start + noise[0], end + noise[1], bits.tolist()))
    assert found == pytest.approx(4 * 4.0)


def test_links_between_places_without_order_nearly_all_tell():
    """Now and then such a place lies on one line with others, both ways, by chance."""
    places = np.random.default_rng(1).uniform(0, 60, (12, 2)) @ [1, 1j]
    bits = [3.0] * 11
    assert 30.0 <= sum(_without_repeats(places[:-1], places[1:], bits)) <= 33.0
