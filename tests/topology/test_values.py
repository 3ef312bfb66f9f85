"""Values are checked at birth and cannot change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from topobatch.topology.frozen import frozen_array
from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import Passes
from topobatch.topology.ragged import Ragged

rows = st.lists(st.lists(st.floats(-10, 10), max_size=4), max_size=8)


@given(rows)
def test_ragged_gives_back_its_rows(lists):
    ragged = Ragged.from_rows(lists)
    assert [ragged[i].tolist() for i in range(len(ragged))] == lists
    assert ragged.owner.tolist() == [i for i, row in enumerate(lists) for _ in row]


@given(rows, st.data())
def test_ragged_take(lists, data):
    pick = data.draw(st.lists(st.integers(0, len(lists) - 1), max_size=6)) if lists else []
    taken = Ragged.from_rows(lists).take(pick)
    assert [taken[i].tolist() for i in range(len(taken))] == [lists[i] for i in pick]


@pytest.mark.parametrize(
    ("offsets", "values"),
    [([0, 1], [1.0, 2.0]), ([1, 2], [1.0, 2.0]), ([0, 2, 1, 2], [1.0, 2.0]), ([0, 1], [np.nan])],
)
def test_ragged_refuses_nonsense(offsets, values):
    with pytest.raises(ValueError, match=r"offsets|finite"):
        Ragged(np.array(offsets), np.array(values))


def test_ragged_row_out_of_range():
    with pytest.raises(IndexError):
        Ragged.from_rows([[1.0]])[-1]


def test_frozen_array_does_not_follow_its_source():
    source = np.arange(6.0).reshape(3, 2)
    frozen = frozen_array(source, np.float64, (3, 2), "x")
    source[0, 0] = 99
    assert frozen[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        frozen[0, 0] = 1
    assert source.flags.writeable


def test_frozen_array_refuses():
    with pytest.raises(ValueError, match="shape"):
        frozen_array(np.zeros((3, 2)), np.float64, (None, 3), "x")
    with pytest.raises(ValueError, match="finite"):
        frozen_array([1.0, np.inf], np.float64, (None,), "x")
    with pytest.raises(ValueError, match="fractions"):
        frozen_array([1.5], np.int64, (None,), "x")


def test_odometry_interpolates_through_the_cut_of_the_angle():
    track = Odometry(
        np.array([0, 10, 20]),
        np.array([[0, 0, 3.0], [1, 0, -3.0], [2, 1, -2.0]]),
        np.zeros(0, np.int64),
    )
    pose = track.at(np.array([5, 15, -5, 99]))
    assert abs(pose[0, 2]) == pytest.approx(np.pi)
    np.testing.assert_allclose(pose[1], [1.5, 0.5, -2.5])
    np.testing.assert_allclose(pose[2], [0, 0, 3.0])
    np.testing.assert_allclose(pose[3], [2, 1, -2.0])
    np.testing.assert_allclose(track.turn_rad, [0, 2 * np.pi - 6, 1.0])


def test_odometry_breaks_carry_no_motion():
    track = Odometry(np.array([0, 1, 2]), np.array([[0, 0, 0], [1, 0, 0], [50, 9, 2]]), [2])
    assert track.step_m.tolist() == [0, 1, 0]
    assert track.turn_rad.tolist() == [0, 0, 0]


@pytest.mark.parametrize("jumps", [[0], [3], [2, 1]])
def test_odometry_jumps_lie_within_the_track(jumps):
    with pytest.raises(ValueError, match="jumps"):
        Odometry(np.arange(3), np.zeros((3, 3)), np.zeros(0, np.int64), jumps=np.array(jumps))


def test_odometry_cuts_are_breaks_and_jumps():
    track = Odometry(
        np.arange(9),
        np.zeros((9, 3)),
        np.array([2, 7]),
        jumps=np.array([4, 7]),
        jump_sigma=np.ones((2, 2)),
        jump_other=np.zeros((2, 3)),
    )
    assert track.cuts.tolist() == [2, 4, 7]


@pytest.mark.parametrize("times", [[0, 0, 1], [0, 2, 1]])
def test_odometry_times_must_ascend(times):
    with pytest.raises(ValueError, match="ascend"):
        Odometry(np.array(times), np.zeros((3, 3)), np.zeros(0, np.int64))


def some_passes() -> Passes:
    branches = Ragged.from_rows([[-1.0, 2.0], [0.5]])
    return Passes(
        time_ns=[10, 20],
        start_ns=[9, 19],
        end_ns=[11, 21],
        centre=np.zeros((2, 2)),
        branches=branches,
        support=Ragged.from_rows([[1.0, 1.0], [1.0]]),
        entry=[-1, 0],
        exit=[1, 0],
        messages=[3, 3],
        confidence=[1.0, 1.0],
    )


def test_passes_check_their_branches():
    good = some_passes()
    with pytest.raises(ValueError, match="exit"):
        replace(good, exit=np.array([1, 1]))
    with pytest.raises(ValueError, match="support"):
        replace(good, support=Ragged.from_rows([[1.0], [1.0]]))
    with pytest.raises(ValueError, match="order"):
        replace(good, time_ns=np.array([20, 10]))
