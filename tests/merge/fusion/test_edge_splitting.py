"""Corridors through junctions that their own run missed, split at them."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.merge.fusion.edge_splitting import split_at_places
from topobatch.merge.fusion.edges import Corridor

XY = np.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]])
BRANCHES = [np.array([0.0]), np.array([-np.pi, 0.0, 1.5]), np.array([-np.pi, 1.0])]


def corridor(run: str, ends: tuple[int, int], branches: tuple[int, int], length: float) -> Corridor:
    u, v = ends
    return Corridor(
        u=u,
        v=v,
        branch_u=branches[0],
        branch_v=branches[1],
        length=length,
        sigma=0.2,
        traversals=1,
        path=XY[[u, v]],
        members=((run, 0),),
        shared=0.0,
        way=0.1,
    )


def test_a_corridor_through_a_known_junction_is_split_there():
    known, through = corridor("a", (0, 1), (0, 0), 5.0), corridor("b", (0, 2), (0, 0), 10.2)
    first, second = split_at_places([known, through], XY, BRANCHES)
    assert (first.u, first.branch_u, first.v, first.branch_v) == (0, 0, 1, 0)
    assert first.members == (("a", 0), ("b", 0))
    # The other half, which no run drove by itself: lengths as on the path, in proportion.
    assert (second.u, second.branch_u, second.v, second.branch_v) == (1, 1, 2, 0)
    assert second.members == (("b", 0),)
    assert second.length == pytest.approx(5.1)
    assert second.sigma == pytest.approx(np.hypot(0.2 / np.sqrt(2), 0.1))
    np.testing.assert_allclose(second.path[[0, -1]], XY[1:])


@pytest.mark.parametrize("middle", [[1.5], [-np.pi, 1.5], [0.0, 1.5]])
def test_it_stays_whole_without_branches_along_its_path(middle):
    both = [corridor("a", (0, 1), (0, 0), 5.0), corridor("b", (0, 2), (0, 0), 10.2)]
    kept = split_at_places(both, XY, [BRANCHES[0], np.array(middle), BRANCHES[2]])
    assert [(c.u, c.v, c.members) for c in kept] == [(c.u, c.v, c.members) for c in both]


def test_it_stays_whole_where_no_part_is_known():
    through = corridor("b", (0, 2), (0, 0), 10.2)
    assert split_at_places([through], XY, BRANCHES) == [through]
