"""How much of the way corridors stand for."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.driven_shares import driven_shares
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import TopoMap
from topobatch.topology.visits import Visits

SECOND = 10**9


def line(*junctions: float) -> TopoMap:
    """Junctions on a line, a corridor from each to the next."""
    n = len(junctions)
    xy = np.column_stack([junctions, np.zeros(n)])
    return TopoMap(
        run="run",
        frame="odom",
        xy=xy,
        branches=Ragged.from_rows([np.array([-1.57, 0.0, 3.14])] * n),
        kind=("junction",) * n,
        source=np.arange(n - 1),
        target=np.arange(1, n),
        source_branch=np.ones(n - 1, np.int64),
        target_branch=np.full(n - 1, 2),
        length=np.diff(np.array(junctions)),
        length_sigma=np.full(n - 1, 0.1),
        traversals=np.ones(n - 1, np.int64),
        paths=tuple(xy[k : k + 2] for k in range(n - 1)),
        observation_vertex=np.arange(n),
        observation_time_ns=np.arange(n) * SECOND,
    )


def test_what_is_driven_into_a_room_and_out_again_is_told_apart() -> None:
    """A metre a second: 2 m to a junction at 2, on to 12, 3 m into a room and back, back to 2, on
    for 4 m."""
    x = np.concatenate(
        [np.arange(0, 12.0), np.full(6, 12.0), np.arange(12, 2, -1.0), np.arange(2, -3, -1.0)]
    )
    y = np.zeros(len(x))
    y[12:18] = [0, 1, 2, 3, 2, 1]
    odometry = Odometry(
        np.arange(len(x)) * SECOND, np.column_stack([x, y, 0 * x]), np.zeros(0, np.int64)
    )
    topomap, rows = line(2.0, 12.0), np.array([2, 12, 18, 28])
    visits = Visits(
        odometry.time_ns[rows],
        np.array([0, 1, 1, 0]),
        np.ones(4, bool),
        np.column_stack([x[rows], y[rows], 0 * rows]),
        odometry.pose[rows, :2],
        np.zeros(4, int),
    )
    told = driven_shares(topomap, odometry, visits)
    assert told["way_m"] == pytest.approx(32.0)
    # Up to a metre beside its end, a corridor is still driven along.
    assert told["corridors"] == pytest.approx(24 / 32, abs=0.02)
    assert told["out_and_back"] == pytest.approx(4 / 32, abs=0.02)
    assert told["ends"] == pytest.approx(4 / 32, abs=0.02)
