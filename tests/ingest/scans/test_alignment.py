"""Scans matched where the odometry leads astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.scans import alignment, association
from topobatch.ingest.scans.alignment import AlignmentSettings, Steps, align, match_steps
from topobatch.ingest.scans.association import Gate, Swept, pair_terms
from topobatch.topology.se2 import between, compose

from .building import WHOLE_TURN, Building


def test_what_is_searched_for_in_parts_is_found_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory follows the part, and no pair hangs on the others."""
    room = Building.of((0.0, 0.0, 7.0, 4.0), (3.0, 3.9, 4.5, 9.0))
    turned = np.array([0.0, 0.5, 0.0, 0.45, 0.9, 0.95])
    pose = np.array([(2.0 + 0.1 * k, 1.5, turn) for k, turn in enumerate(turned)])
    ranges = room.ranges(pose, WHOLE_TURN)
    along = np.stack([np.cos(WHOLE_TURN), np.sin(WHOLE_TURN)], axis=-1)
    xy = (ranges[..., None] * along).astype(np.float32)
    step = np.full(len(pose), WHOLE_TURN[1] - WHOLE_TURN[0])
    scans = Swept.of(xy, np.full(len(pose), WHOLE_TURN[0]), step)
    first = np.arange(1, len(pose))
    # The odometry says that the robot went straight on.
    straight = Steps(np.tile([0.1, 0.0, 0.0], (5, 1)), np.tile(np.diag([1e4, 1e4, 1e4]), (5, 1, 1)))
    found = match_steps(scans, (first, first - 1), straight, AlignmentSettings())
    assert found.searched.any()
    monkeypatch.setattr(alignment, "MOST_POINTS", 1)
    again = match_steps(scans, (first, first - 1), straight, AlignmentSettings())
    assert again.motion.tobytes() == found.motion.tobytes()
    assert (again.searched == found.searched).all()
    assert np.abs(found.motion[found.searched, 2] - np.diff(turned)[found.searched]).max() < 0.05


def room_seen_from(pose: np.ndarray) -> Swept:
    room = Building.of((0.0, 0.0, 7.0, 4.0), (3.0, 3.9, 4.5, 9.0))
    along = np.stack([np.cos(WHOLE_TURN), np.sin(WHOLE_TURN)], axis=-1)
    xy = (room.ranges(pose, WHOLE_TURN)[..., None] * along).astype(np.float32)
    step = np.full(len(pose), WHOLE_TURN[1] - WHOLE_TURN[0])
    return Swept.of(xy, np.full(len(pose), WHOLE_TURN[0]), step)


def test_the_same_raster_begun_a_turn_later_matches_the_same() -> None:
    scans = room_seen_from(np.array([(2.0, 1.5, 0.0), (2.2, 1.6, 0.1)]))
    later = replace(scans, start=scans.start + 2 * np.pi)
    one, two = np.array([1]), np.array([0])
    motion, gate = np.array([[0.2, 0.1, 0.1]]), Gate(0.2, 0.05)
    told, again = (pair_terms(s, one, two, motion, gate) for s in (scans, later))
    assert told.fit[0] > 0.95
    assert again.fit == told.fit
    np.testing.assert_allclose(again.moments, told.moments, rtol=1e-3, atol=1e-3)


def test_every_second_beam_tells_the_same_as_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a dense scan: a point stands for the beams beside it, and in the end each has its say."""
    bearing = np.linspace(-np.pi, np.pi, 361)[:-1]
    room = Building.of((0.0, 0.0, 7.0, 4.0), (3.0, 3.9, 4.5, 9.0))
    pose = np.array([(2.0, 1.5, 0.0), (2.2, 1.6, 0.1), (2.4, 1.6, 0.2)])
    along = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    xy = (room.ranges(pose, bearing)[..., None] * along).astype(np.float32)
    step = np.full(3, bearing[1] - bearing[0])
    first, second = np.array([1, 2]), np.array([0, 1])
    off, gate = np.array([0.02, 0.01, 0.01]), Gate(0.2, 0.05)
    motion = between(pose[second], pose[first]) + off
    some = Swept.of(xy, np.full(3, -np.pi), step)
    told = pair_terms(some, first, second, motion, gate)
    monkeypatch.setattr(association, "POINT_RAD", step[0])
    whole = Swept.of(xy, np.full(3, -np.pi), step)
    again = pair_terms(whole, first, second, motion, gate)
    assert (some.each, whole.each) == (2, 1)
    size = np.sqrt(np.diagonal(again.moments, axis1=1, axis2=2))
    apart = np.abs(told.moments - again.moments) / (size[:, :, None] * size[:, None])
    assert apart.max() < 0.02
    assert np.abs(told.weight / again.weight - 1).max() < 0.02
    assert np.abs(told.fit - again.fit).max() < 0.02
    counted = [set(np.hypot(p.x, p.y)[p.valid].tolist()) for p in (some.points, whole.points)]
    assert counted[0] == counted[1]


def test_poses_fall_into_place_together() -> None:
    """From poses 10 cm and 3 degrees off, and an odometry that says the same."""
    rng = np.random.default_rng(5)
    n = 12
    real = np.column_stack([np.linspace(1.5, 3.5, n), np.full(n, 1.5), np.linspace(0, 0.6, n)])
    scans = room_seen_from(real)
    off = np.column_stack([rng.normal(0, 0.05, (n, 2)), rng.normal(0, 0.03, n)])
    off[0] = 0.0
    start = compose(real, off)
    weak = np.tile(np.diag([100.0, 100.0, 100.0]), (n - 1, 1, 1))
    earlier = [np.arange(n) - 1, np.maximum(np.arange(n) - 2, -1), np.maximum(np.arange(n) - 4, -1)]
    steps = Steps(between(start[:-1], start[1:]), weak)
    found = align(scans, start, steps, fixed=1, earlier=earlier, settings=AlignmentSettings())
    error = between(real, found.pose)
    assert np.abs(error[:, :2]).max() < 0.01
    assert np.abs(error[:, 2]).max() < 0.005
    assert found.pose[0] == pytest.approx(real[0], abs=1e-6)
