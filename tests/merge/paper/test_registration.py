"""Registration: against known motions, the transform of one set, and brute force."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.merge.paper.registration import fit_groups
from topobatch.topology.se2 import apply, fit_rigid


def registered(a, b):
    """T_a_b of one group, free to turn."""
    xy = np.asarray(a, float), np.asarray(b, float)
    return fit_groups(*xy, np.zeros(len(a), np.int64), np.zeros(1), free=np.ones(1, bool))[0]


def test_registration_recovers_a_motion_and_agrees_with_that_of_one_set():
    rng = np.random.default_rng(0)
    for _ in range(50):
        xy, T = rng.normal(0, 5, (6, 2)), rng.uniform(-3, 3, 3)
        assert registered(apply(T, xy), xy) == pytest.approx(T, abs=1e-9)
        noisy = apply(T, xy) + rng.normal(0, 0.5, (6, 2))
        assert registered(noisy, xy) == pytest.approx(fit_rigid(noisy, xy), abs=1e-9)


def test_registration_of_mirrored_points_is_a_rotation_never_a_reflection():
    rng = np.random.default_rng(1)
    for _ in range(8):
        xy = rng.normal(0, 5, (5, 2))
        mirrored = xy * [1.0, -1.0]
        best = ((apply(registered(mirrored, xy), xy) - mirrored) ** 2).sum()
        for theta in np.linspace(-np.pi, np.pi, 181):
            R = np.array([0.0, 0.0, theta])
            shift = mirrored.mean(axis=0) - apply(R, xy).mean(axis=0)
            assert ((apply(R, xy) + shift - mirrored) ** 2).sum() >= best - 1e-9


def test_registration_of_collinear_single_and_coinciding_points():
    line = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]])
    T = np.array([2.0, -1.0, 2.5])
    assert registered(apply(T, line), line) == pytest.approx(T)
    assert registered([[3.0, 4.0]], [[1.0, 1.0]]) == pytest.approx([2.0, 3.0, 0.0])
    assert registered(np.ones((3, 2)), np.zeros((3, 2))) == pytest.approx([1.0, 1.0, 0.0])


def test_groups_are_registered_as_if_alone_and_keep_the_rotations_that_are_given():
    rng = np.random.default_rng(2)
    group = np.array([0, 1, 0, 1, 1, 0, 2])
    a, b = rng.normal(0, 3, (7, 2)), rng.normal(0, 3, (7, 2))
    free = np.array([True, True, False])
    together = fit_groups(a, b, group, np.array([0.0, 1.0, 0.5]), free=free)
    for k in (0, 1):
        assert together[k] == pytest.approx(registered(a[group == k], b[group == k]))
    assert apply(together[2], b[6]) == pytest.approx(a[6])
    assert together[2, 2] == 0.5


def test_reweighting_holds_one_wrong_pair_off():
    rng = np.random.default_rng(3)
    xy, T = rng.normal(0, 5, (9, 2)), np.array([1.0, -2.0, 0.4])
    moved = apply(T, xy)
    moved[0] += 20.0
    one, turn, free = np.zeros(9, np.int64), np.zeros(1), np.ones(1, bool)
    plain = fit_groups(moved, xy, one, turn, free=free)[0]
    robust = fit_groups(moved, xy, one, turn, free=free, weights="reweighted")[0]
    assert np.abs(plain - T).max() > 0.5
    assert np.abs(robust - T).max() < 0.02
