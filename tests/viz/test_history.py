from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.odometry import Odometry
from topobatch.topology.topomap import Closure
from topobatch.viz.history import history, questions
from topobatch.viz.odometry_health import BROKEN, GAP, JUMP, STANDING, lanes

S = 10**9


def test_corridors_count_from_their_first_drive(make_map) -> None:
    known = history(make_map("a"))  # 0, 1, 2, 4, 2, 3, 0, 1 at 10 … 17 s
    assert (known.vertex_ns // S).tolist() == [10, 11, 12, 15, 13]
    assert (known.corridor_ns // S).tolist() == [11, 12, 15, 16, 13]
    assert known.visit.tolist() == [1, 1, 1, 1, 2, 1, 2, 2]


def test_a_junction_driven_by_unseen_counts_with_its_corridors(make_map) -> None:
    topomap = make_map("a")
    seen = topomap.observation_vertex != 1
    missed = replace(
        topomap,
        observation_vertex=topomap.observation_vertex[seen],
        observation_time_ns=topomap.observation_time_ns[seen],
    )
    known = history(missed)  # from 0 to 2 by two corridors, past 1
    assert (known.corridor_ns[:2] // S).tolist() == [11, 12]
    assert known.vertex_ns[1] // S == 11


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


def test_steady_odometry_has_one_state(straight, empty_map) -> None:
    assert states(straight, empty_map, "odometry") == [(0.0, "steady")]
    assert states(straight, empty_map, "motion") == [(0.0, "driving")]
    assert [lane.name for lane in lanes(straight, empty_map)] == ["odometry", "motion"]


def test_gaps_jumps_and_breaks_are_seen(straight, empty_map) -> None:
    keep = np.r_[0:1000, 1200:6000]
    hurt = Odometry(
        straight.time_ns[keep],
        straight.pose[keep],
        breaks=np.array([4000]),
        jumps=np.array([2500]),
        jump_sigma=np.ones((1, 2)),
        jump_other=np.zeros((1, 3)),
    )
    found = states(hurt, empty_map, "odometry")
    assert [state for _, state in found] == [
        "steady",
        GAP,
        "steady",
        JUMP,
        "steady",
        BROKEN,
        "steady",
    ]
    assert [begin for begin, _ in found][1:3] == pytest.approx([99.9, 120.0])
    assert found[4][0] - found[3][0] == pytest.approx(3.0, rel=0.01)  # long enough to be seen


def test_standing_is_seen(straight, empty_map) -> None:
    pose = np.array(straight.pose)
    pose[2000:2600, 0] = pose[2000, 0]
    pose[2600:, 0] -= 60.0
    found = states(replace(straight, pose=pose), empty_map, "motion")
    assert [state for _, state in found] == ["driving", STANDING, "driving"]
    assert [begin for begin, _ in found] == pytest.approx([0.0, 200.0, 260.0], abs=0.3)


def test_known_ground_is_told_from_new(straight, make_map) -> None:
    found = states(straight, make_map("a"), "ground")
    assert found == [
        (10.0, "new ground"),
        (14.0, "known ground"),
        (15.0, "new ground"),
        (16.0, "known ground"),
    ]
