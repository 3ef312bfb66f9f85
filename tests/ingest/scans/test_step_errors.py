"""What an odometry gets wrong, learned from its steps as the scans have them."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.keyframes import Keyframes
from topobatch.ingest.scans.step_errors import StepErrors
from topobatch.topology.se2 import between, compose, wrap

MOUNTS = np.array([(0.3, 0.0, 0.0), (-0.2, 0.1, np.pi)])
SCALE, DIRECTION, CENTRE, BIAS = 0.97, 0.01, np.array([0.08, -0.02]), 0.03


def frames(n: int = 400) -> tuple[Keyframes, np.ndarray]:
    """Keyframes of two lasers in turn, one of which looks back, and their true poses; the robot
    drives backwards half of the time."""
    rng = np.random.default_rng(3)
    motion = np.column_stack([np.full(n, 0.25), np.zeros(n), rng.normal(0, 0.15, n)])
    motion[n // 2 :, 0] *= -1
    real, told = np.zeros((n, 3)), np.zeros((n, 3))
    centre = np.array([*CENTRE, 0.0])
    for k in range(1, n):
        real[k] = compose(real[k - 1], motion[k])
        own = between(compose(real[k - 1], centre), compose(real[k], centre))
        turn = own[2] - BIAS * own[0]
        c, s = np.cos(DIRECTION), np.sin(DIRECTION)
        own = np.array([*(np.array([[c, s], [-s, c]]) @ own[:2] / SCALE), turn])
        told[k] = compose(told[k - 1], own)
    mount = MOUNTS[np.arange(n) % 2]
    zeros = np.zeros(n)
    keyframes = Keyframes(
        np.arange(n) * 10**9,
        compose(told, mount),
        mount,
        np.zeros((n, 1, 2), np.float32),
        zeros,
        zeros + 0.01,
        np.ones(n, np.int64),
        zeros,
        zeros,
        np.zeros(n, np.int64),
        np.arange(n) % 2,
    )
    return keyframes, compose(real, mount)


def test_steps_are_those_of_the_robot_once_learned() -> None:
    keyframes, real = frames()
    n = len(real)
    pairs = np.arange(2, n), np.arange(n - 2)
    sure = np.ones(n - 2, bool)
    motion = between(real[pairs[1]], real[pairs[0]])
    errors = StepErrors().learned(keyframes, pairs, (motion, sure, sure))
    assert errors.terms[0] == pytest.approx(BIAS, abs=0.003)
    assert errors.shift.terms == pytest.approx(
        [SCALE - 1, SCALE * DIRECTION, -CENTRE[0], -CENTRE[1]], abs=0.005
    )
    # From laser to laser, one of which looks the other way, as from scan to scan of one.
    steps = errors.steps(keyframes, np.arange(1, n), np.arange(n - 1)).motion
    off = steps - between(real[:-1], real[1:])
    raw = between(keyframes.odometry[:-1], keyframes.odometry[1:]) - between(real[:-1], real[1:])
    assert np.abs(raw[:, :2]).max() > 0.02
    assert np.abs(off[:, :2]).max() < 0.003
    assert np.abs(wrap(raw[:, 2])).max() > 0.006
    assert np.abs(wrap(off[:, 2])).max() < 0.002
