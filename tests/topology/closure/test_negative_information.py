"""Where no other junction can be, for the robot drove there and reported none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from topobatch.topology.closure.negative_information import DrivenGround, driven_ground
from topobatch.topology.closure.places import NOWHERE

CORE_M, REACH_M = 1.5, 0.6


def sampled(ground, shift, cov, side):
    """Share of samples of one shift that lie on the ground of one side, by definition."""
    points = np.random.default_rng(5).multivariate_normal(shift, cov, 200_000)
    on = np.zeros(len(points), bool)
    for along, length in zip(ground.along[0, side], ground.length[0, side], strict=True):
        far = points @ along
        off = points @ [-along[1], along[0]]
        on |= (np.abs(off) < REACH_M) & (far > CORE_M) & (far < length - CORE_M)
    return float(on.mean())


@pytest.mark.parametrize("cov", [np.diag([0.1, 1.6]), [[0.5, 0.4], [0.4, 0.9]], 9.0 * np.eye(2)])
@pytest.mark.parametrize("shift", [[0.2, 2.4], [1.5, 1.0], [-3.0, -1.0]])
def test_the_share_is_that_of_what_is_known_of_the_shift(shift, cov):
    angle = np.radians([[[95.0, -170.0], [80.0, 10.0]]])
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    ground = DrivenGround(along, np.array([[[6.0, 4.0], [0.0, 8.0]]]))
    share = ground.share(np.array([shift]), np.array([cov]), CORE_M, REACH_M)
    told = max(sampled(ground, shift, cov, side) for side in (0, 1))
    assert share[0] == pytest.approx(told, abs=0.02)


def test_ground_is_straight_corridors_only_and_each_place_lies_on_the_others():
    """Place 0 was left east to 1, straight, and north to 2, by a bend."""
    xy = np.array([[0.0, 0.0], [8.0, 0.0], [0.0, 8.0], [5.0, 0.5]])
    places = SimpleNamespace(
        next_place=np.array([[1, 2], [0, NOWHERE], [0, NOWHERE], [NOWHERE, NOWHERE]]),
        length=np.array([[8.02, 9.5], [8.02, np.nan], [9.5, np.nan], [np.nan, np.nan]]),
    )
    a, b = np.array([0, 3]), np.array([3, 0])
    ground = driven_ground(places, xy, a, b, REACH_M)
    np.testing.assert_allclose(ground.length[0], [[8.0, 0.0], [0.0, 0.0]])
    cov = np.broadcast_to(0.01 * np.eye(2), (2, 2, 2))
    share = ground.share(xy[a] - xy[b], cov, CORE_M, REACH_M)
    assert share == pytest.approx([0.84, 0.84], abs=0.01)  # 0.5 m off its line, 0.6 m is within
    assert ground[np.array([1])].share(np.array([[5.0, 3.0]]), cov[:1], CORE_M, REACH_M)[0] < 1e-6
