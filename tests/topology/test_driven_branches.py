"""Which branches were driven: those that corridors name, or leave in the direction of."""

from __future__ import annotations

import numpy as np

from topobatch.topology.driven_branches import driven_branches
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import Graph


def corridor(source_branch: int, path: list[tuple[float, float]]) -> Graph:
    """A junction with branches to the east and north, and a corridor to another."""
    return Graph(
        xy=np.array([path[0], path[-1]]),
        branches=Ragged.from_rows([np.array([0.0, np.pi / 2]), np.array([-np.pi])]),
        kind=("junction", "dead_end"),
        source=np.array([0]),
        target=np.array([1]),
        source_branch=np.array([source_branch]),
        target_branch=np.array([0]),
        length=np.array([5.0]),
        length_sigma=np.array([0.1]),
        traversals=np.array([1]),
        paths=(np.array(path),),
    )


def test_a_corridor_drives_the_branch_that_it_names() -> None:
    north = [(0.0, 0.0), (0.0, 5.0)]
    assert driven_branches(corridor(0, north)).tolist() == [True, False, True]
