"""The simulated laser: what it meets is what stands there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from topobatch.simulation.chance import Chance
from topobatch.simulation.laser import cast_at_segments, scans
from topobatch.simulation.motion import Drive
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import LASERS, ScenarioSettings
from topobatch.simulation.walls import free_space, walls_of
from topobatch.simulation.world import World
from topobatch.simulation.worlds import make_world

BARE = replace(LASERS["none"], noise_m=0.0)


def standing(x: float, y: float, theta: float, seconds: float = 5.0) -> Drive:
    none = np.zeros(0, np.int64)
    return Drive(
        np.array([0.0, seconds]),
        np.array([[x, y, theta], [x, y, theta]]),
        np.zeros(2),
        none,
        np.zeros(0),
        none,
        np.zeros(0),
        np.zeros(0),
    )


def line(*points: tuple[float, float], links: Any = ((0, 1),)) -> World:
    xy = np.array(points, np.float64)
    paths = tuple(np.array([xy[u], xy[v]]) for u, v in links)
    source, target = np.array(links).T
    return World("w", "maze", xy, source, target, paths)


def test_a_crossing_from_its_middle() -> None:
    world = line((0, 0), (20, 0), (0, 20), (-20, 0), (0, -20), links=[(0, k) for k in range(1, 5)])
    settings = replace(BARE, beams=181, view_deg=180.0, mount=(0.0, 0.0, 0.0), corridor_m=2.0)
    seen = scans(world, standing(0, 0, 0), set(), settings, Chance("x"))
    assert len(seen) == 24
    ranges = seen.ranges_m[0]
    assert ranges[[0, 90, 180]].tolist() == [np.inf] * 3, "down the corridors"
    # The four corners, at one metre in x and y.
    np.testing.assert_allclose(ranges[[45, 135]], np.sqrt(2), atol=0.01)
    # Walls of the corridor ahead, one metre to the side.
    np.testing.assert_allclose(ranges[100], 1 / np.sin(np.radians(10)), atol=0.01)


def test_the_robot_drives_on_during_a_sweep() -> None:
    world = line((0, 0), (8, 0))
    settings = replace(BARE, beams=91, view_deg=90.0, mount=(0.0, 0.0, 0.0), range_max_m=12.0)
    moving = replace(standing(1, 0, 0), pose=np.array([[1.0, 0, 0], [6.0, 0, 0]]))
    at_once = scans(world, moving, set(), replace(settings, sweep_s=0.0), Chance("x"))
    swept = scans(world, moving, set(), settings, Chance("x"))
    # Half a sweep later it is 5 cm nearer to the room's end wall.
    count = min(len(at_once), len(swept))
    gap = at_once.ranges_m[:count, 45] - swept.ranges_m[:count, 45]
    assert gap.mean() == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize("kind", ["maze", "office", "organic", "city", "rows"])
def test_walls_stand_around_the_free_space_and_nowhere_within(kind: str) -> None:
    world = make_world(kind, 30, 2)
    walls = walls_of(world, 1.4)
    middle = 0.5 * (walls.a + walls.b)
    for polygon in free_space(world, 1.4):
        side = np.roll(polygon, -1, axis=0) - polygon
        outwards = np.column_stack([side[:, 1], -side[:, 0]]) / np.hypot(*side.T)[:, None]
        depth = np.einsum("nsk,sk->ns", polygon[None] - middle[:, None], outwards).min(axis=1)
        assert depth.max() < 1e-5, "a wall stands in a corridor"
    # Nobody gets out: a beam in any direction from any junction meets a wall.
    angle = np.linspace(-np.pi, np.pi, 50, endpoint=False)
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    for xy in world.xy:
        way, _, _ = cast_at_segments(np.tile(xy, (50, 1)), direction, walls)
        assert np.isfinite(way).all()


def test_the_same_settings_give_the_same_scans_and_detections_stay_as_they_were() -> None:
    plain = ScenarioSettings("maze", runs=1, junctions_per_run=8, seed=5)
    first, again, without = (
        simulate_scenario(s).simulated[0]
        for s in (replace(plain, laser="harsh"), replace(plain, laser="harsh"), plain)
    )
    assert first.scans is not None
    assert again.scans is not None
    assert without.scans is None
    np.testing.assert_array_equal(first.scans.ranges_m, again.scans.ranges_m)
    np.testing.assert_array_equal(first.run.detections.centre, without.run.detections.centre)
    np.testing.assert_array_equal(first.run.odometry.pose, without.run.odometry.pose)
    assert without.truth.settings["laser"] is None
