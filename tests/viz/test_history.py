from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.odometry import Odometry
from topobatch.topology.topomap import Closure
from topobatch.viz.history import history, questions
from topobatch.viz.odometry_health import lanes

S = 10**9


def test_corridors_count_from_their_first_drive(make_map) -> None:
    known = history(make_map("a"))  # 0, 1, 2, 4, 2, 3, 0, 1 at 10 … 17 s
    assert (known.vertex_ns // S).tolist() == [10, 11, 12, 15, 13]
    assert (known.corridor_ns // S).tolist() == [11, 12, 15, 16, 13]
    assert known.visit.tolist() == [1, 1, 1, 1, 2, 1, 2, 2]


def test_closures_are_told_by_junctions(make_map) -> None:
    topomap = make_map("a")
    phantom = Closure(10 * S, 999 * S, False, 1.0, "no junction")
    revised = Closure(11 * S, 12 * S, False, 1.0, "put off", revised=True)
    topomap = replace(topomap, closures=(*topomap.closures, phantom, revised))
    told = [q.told for q in questions(topomap, history(topomap).visit)]
    assert told == [
        "junction 0: visit 2 recognised as visit 1, +21.5 bits: the square closes",
        "junction 1 (visit 2) not taken for junction 2 (visit 1), -3.0 bits: "
        "2 | 1 have *other* branches",
        "a pass that is no junction not taken for junction 0 (visit 1), +1.0 bits: no junction",
    ]


def states(odometry: Odometry, topomap, name: str) -> list[tuple[float, str]]:
    (lane,) = (lane for lane in lanes(odometry, topomap) if lane.name == name)
    return list(zip((lane.time_ns / S).tolist(), lane.states, strict=True))


@pytest.fixture
def straight() -> Odometry:
    """Ten minutes straight on at 1 m/s, 10 poses a second."""
    times = np.arange(6000) * (S // 10)
    pose = np.column_stack([times / S, np.zeros(6000), np.zeros(6000)])
    return Odometry(times, pose, np.zeros(0, np.int64))
