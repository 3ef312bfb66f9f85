"""What structural matching needs of a map."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.matching.structure import grid_direction, prepare
from topobatch.topology.passes import NO_BRANCH

from .test_association import topomap


@pytest.mark.parametrize("grid", [0.0, 0.3, 1.5])
def test_a_grid_is_found_by_its_direction(grid):
    rng = np.random.default_rng(0)
    heading = grid + np.pi / 2 * rng.integers(0, 4, 60) + rng.normal(0, 0.05, 60)
    assert grid_direction(heading) == pytest.approx(grid, abs=0.02)
    # An eighth may point anywhere, a third may not.
    askew = np.where(np.arange(60) % 12 == 0, heading + 0.6, heading)
    assert grid_direction(askew) is not None
    assert grid_direction(np.where(np.arange(60) % 3 == 0, heading + 0.6, heading)) is None
    assert grid_direction(np.zeros(0)) is None


def test_an_unknown_branch_is_the_free_one_along_the_path():
    def ends(branches):
        m = topomap([branches, [np.pi]], [(0, NO_BRANCH, 1, 0, 5.0)])
        return prepare(m).out_branch.tolist()

    # The path leads from (0, 0) to (5, 1): 0.2 rad.
    assert ends([-1.5, 0.1, 1.5]) == [1, 0]
    assert ends([-1.5, 1.5]) == []
