"""SE(2): group laws and registration, on asymmetric data."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from topobatch.topology import se2

coordinate = st.floats(-1e3, 1e3)
pose = st.tuples(coordinate, coordinate, st.floats(-10, 10)).map(np.array)


def close(a, b):
    np.testing.assert_allclose(a[..., :2], b[..., :2], atol=1e-8)
    np.testing.assert_allclose(se2.wrap(a[..., 2] - b[..., 2]), 0, atol=1e-9)


@given(pose)
def test_inverse_is_on_both_sides(a):
    close(se2.compose(a, se2.inverse(a)), np.zeros(3))
    close(se2.compose(se2.inverse(a), a), np.zeros(3))


def test_compose_by_hand():
    # A quarter turn left at (1, 2): one metre ahead is one metre up.
    T = np.array([1.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(se2.compose(T, [1.0, 0.0, 0.25]), [1, 3, np.pi / 2 + 0.25])
    np.testing.assert_allclose(se2.apply(T, [[1.0, 0.0], [0.0, 1.0]]), [[1, 3], [0, 2]], atol=1e-12)


@given(pose)
def test_fit_rigid_recovers_a_motion(T):
    xy_b = np.array([[0.0, 0.0], [4.0, 1.0], [-2.0, 5.0], [3.0, 3.0]])
    close(se2.fit_rigid(se2.apply(T, xy_b), xy_b), T)


def test_fit_rigid_never_mirrors():
    xy_b = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 1.0]])
    fit = se2.fit_rigid(xy_b * [1.0, -1.0], xy_b)
    moved = se2.apply(fit, xy_b)
    first, second = moved[1] - moved[0], moved[2] - moved[0]
    assert first[0] * second[1] - first[1] * second[0] > 0


def test_the_rigid_fit_is_the_least_of_weighted_squares():
    """Against brute force over rotations; far from the origin, too."""
    rng = np.random.default_rng(5)
    xy_a, xy_b, weight = rng.normal(0, 5, (8, 2)), rng.normal(0, 5, (8, 2)), rng.uniform(0, 2, 8)
    one = np.zeros(8, np.int64)
    fit = se2.fit_groups(xy_a, xy_b, one, weight)[0]

    def error(T):
        return (weight * ((xy_a - se2.apply(T, xy_b)) ** 2).sum(axis=1)).sum()

    mean_a, mean_b = (np.average(xy, axis=0, weights=weight) for xy in (xy_a, xy_b))
    for theta in np.linspace(-np.pi, np.pi, 361):
        shift = mean_a - se2.rotation(theta) @ mean_b
        assert error(np.array([*shift, theta])) >= error(fit) - 1e-9
    far = se2.fit_groups(xy_a + 3e5, xy_b - 3e5, one, weight)[0]
    assert far[2] == pytest.approx(fit[2], abs=1e-8)
    lone, *_ = se2.rigid_from_sums(1.0, 3 + 4j, 1 + 1j, (3 + 4j) * (1 - 1j), 2j)
    assert lone == pytest.approx(1j)  # one pair tells no turn: what else is known does


@given(st.floats(-1e4, 1e4))
def test_wrap_keeps_the_direction(angle):
    wrapped = se2.wrap(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-8)


@given(st.floats(-3.1, 3.1), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_yaw_of_a_tilted_quaternion(yaw, pitch, roll):
    # Product of the three half-angle rotations, z·y·x.
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    cp, sp = np.cos(pitch / 2), np.sin(pitch / 2)
    cr, sr = np.cos(roll / 2), np.sin(roll / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    assert se2.wrap(se2.yaw_from_quaternion(x, y, z, w) - yaw) == pytest.approx(0, abs=1e-9)
    assert se2.wrap(se2.yaw_from_quaternion(-x, -y, -z, -w) - yaw) == pytest.approx(0, abs=1e-9)
