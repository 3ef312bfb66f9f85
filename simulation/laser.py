"""The simulated laser: scans of a world from the robot's true pose, with doors that open and close
and people who walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ..topology.columns import joined, take
from ..topology.se2 import compose
from .chance import Chance, quantised
from .motion import Drive
from .settings import LaserSettings
from .walls import Segments, doorways, walls_of
from .world import World, polyline_at

PANEL_M = 2.0
"""Length of wall panels of one material."""

GLASS_SEEN = 0.97
"""Glass reflects a beam if the cosine of its angle to the normal is at least this."""

PERSON_M = 0.2
"""Radius of a person at the laser's height."""

GRID_BITS = 8
"""Ranges are multiples of 2^-8 m (4 mm), a lidar's typical resolution: logs compress better."""

DOOR_STAYS_S = (20.0, 90.0)
"""Range of the time between changes of a door."""

WAY_CLEAR_S = 6.0
"""A door is open while the robot is near, and for this long before and after."""

WALKING_M_PER_S = (0.8, 1.5)
"""Range of walking speeds."""

ASIDE_M = 0.3
"""People walk this far to the right of the corridor's centre line. They give way to the robot
(leave its scan) within twice this of its centre, and doors within four times this."""

TICK_S = 0.25
"""Time step of doors."""


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """Scans as recorded: time_s (n,) of the first beam; ranges_m (n, m) float32, inf without an
    echo; angles_rad (m,) ascending, in the laser's frame."""

    time_s: FloatArray
    ranges_m: Float32Array
    angles_rad: FloatArray
    settings: LaserSettings

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Everything that beams can hit.

    panel_at: (s,) index of each wall's first panel in `glass`. shut: (t, d) which doors are shut in
    every tick. people: for each ascending times (k,) [s] and the points (k, 2) at them.
    """

    walls: Segments
    glass: BoolArray
    panel_at: IntArray
    doors: Segments
    shut: BoolArray
    people: list[tuple[FloatArray, FloatArray]]


def scans(
    world: World, drive: Drive, closed: set[int], settings: LaserSettings, chance: Chance
) -> Scans:
    """The laser's scans during a drive. O(scans × beams × walls in reach)."""
    scene = _scene(world, drive, closed, settings, chance)
    half = np.radians(0.5 * settings.view_deg)
    angles: FloatArray = np.linspace(-half, half, settings.beams).round(9)
    count = int((float(drive.time_s[-1]) - settings.sweep_s) * settings.rate_hz)
    start = quantised((np.arange(count) + chance.uniform(0.0, 0.2, count)) / settings.rate_hz, 20)
    seen = np.zeros((count, settings.beams))
    for row, time_s in zip(seen, start.tolist(), strict=True):
        row[:] = _cast(drive, time_s, angles, settings, scene)
    seen += chance.normal(settings.noise_m, seen.size).reshape(seen.shape)
    seen[chance.happens(settings.lost_rate, seen.size).reshape(seen.shape)] = np.inf
    finite = np.isfinite(seen)
    seen[finite] = quantised(np.maximum(seen[finite], settings.range_min_m), GRID_BITS)
    # Readers treat ranges of range_max and more as no echo.
    seen[seen >= settings.range_max_m] = np.inf
    return Scans(start, seen.astype(np.float32), angles, settings)


def _scene(
    world: World, drive: Drive, closed: set[int], settings: LaserSettings, chance: Chance
) -> _Scene:
    walls = walls_of(world, settings.corridor_m)
    panels = np.floor(walls.length / PANEL_M).astype(np.int64) + 1
    glass = chance.happens(settings.glass_share, int(panels.sum()))
    doors, shut = _doors(world, drive, closed, settings, chance)
    crowd = round(settings.people_per_100_m * float(world.length.sum()) / 100)
    end_s = float(drive.time_s[-1]) + 1.0
    people = [_wander(world, closed, end_s, chance) for _ in range(crowd)]
    return _Scene(walls, glass, np.cumsum(panels) - panels, doors, shut, people)


def _cast(
    drive: Drive, start_s: float, angles: FloatArray, settings: LaserSettings, scene: _Scene
) -> FloatArray:
    """(m,) true ranges of a scan, inf without a hit."""
    robot = drive.at(start_s + np.linspace(0.0, settings.sweep_s, settings.beams))
    laser = compose(robot, np.array(settings.mount))
    heading = laser[:, 2] + (-angles if settings.upside_down else angles)
    direction = quantised(np.column_stack([np.cos(heading), np.sin(heading)]), 40)
    origin = quantised(laser[:, :2], 26)
    # Noise brings walls just beyond the range within it.
    reach = settings.range_max_m + 5 * settings.noise_m
    low = origin.min(axis=0) - reach
    high = origin.max(axis=0) + reach
    walls = _reached(scene.walls, low, high)
    doors = np.flatnonzero(scene.shut[int(start_s / TICK_S)])
    standing = joined([take(scene.walls, walls), take(scene.doors, doors)])
    way, met, at = cast_at_segments(origin, direction, standing)
    to_people = _cast_at_people(origin, direction, _people_seen(scene, start_s, robot[0, :2]))
    # A beam lost in glass hits nothing behind it: people there are hidden by other walls as well.
    of_wall = np.flatnonzero((way <= to_people) & (met < len(walls)) & np.isfinite(way))
    lost = _lost_in_glass(direction[of_wall], walls[met[of_wall]], at[of_wall], scene)
    out = np.minimum(way, to_people)
    out[of_wall[lost]] = np.inf
    return out


def _reached(segments: Segments, low: FloatArray, high: FloatArray) -> IntArray:
    """Indices of the segments whose bounding box meets the given box."""
    least, most = np.minimum(segments.a, segments.b), np.maximum(segments.a, segments.b)
    return np.flatnonzero(((least <= high) & (most >= low)).all(axis=1))


def _lost_in_glass(
    direction: FloatArray, wall: IntArray, at: FloatArray, scene: _Scene
) -> BoolArray:
    """(r,) which beams that hit a wall, so far along it, hit glass and give no echo."""
    panel = scene.panel_at[wall] + np.floor(at / PANEL_M).astype(np.int64)
    along = (scene.walls.b - scene.walls.a)[wall] / scene.walls.length[wall, None]
    squarely = np.abs(direction[:, 0] * along[:, 1] - direction[:, 1] * along[:, 0])
    return np.asarray(scene.glass[panel] & (squarely < GLASS_SEEN))


def cast_at_segments(
    origin: FloatArray, direction: FloatArray, segments: Segments
) -> tuple[FloatArray, IntArray, FloatArray]:
    """The first hit of each beam on a set of segments. O(r s), vectorised.

    origin, direction: (r, 2), directions of unit length. Returns range (r,) [m], inf without a hit;
    and where there is a hit: segment (r,), and at (r,) distance from the segment's start [m].
    """
    # o + t d = a + u e, solved for all beams against all segments by Cramer's rule.
    ex, ey = (segments.b - segments.a).T
    ax, ay = segments.a[:, 0] - origin[:, :1], segments.a[:, 1] - origin[:, 1:]
    dx, dy = direction[:, :1], direction[:, 1:]
    cross = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (ax * ey - ay * ex) / cross
        share = (ax * dy - ay * dx) / cross
    way = np.where((way > 0) & (share >= 0) & (share <= 1), way, np.inf)
    first = way.argmin(axis=1)
    rows = np.arange(len(origin))
    return way[rows, first], first, share[rows, first] * segments.length[first]


def _cast_at_people(origin: FloatArray, direction: FloatArray, centre: FloatArray) -> FloatArray:
    """(r,) range of each beam to the nearest of the circles around centres (p, 2), else inf."""
    to = centre - origin[:, None]
    along = np.einsum("rpk,rk->rp", to, direction)
    half2 = PERSON_M**2 - (np.einsum("rpk,rpk->rp", to, to) - along**2)
    met = (half2 > 0) & (along > 0)
    way = np.where(met, along - np.sqrt(np.where(met, half2, 0.0)), np.inf)
    return np.asarray(np.where(way > 0, way, np.inf).min(axis=1, initial=np.inf))


def _doors(
    world: World, drive: Drive, closed: set[int], settings: LaserSettings, chance: Chance
) -> tuple[Segments, BoolArray]:
    """Doors at a random share of the possible places, and (t, d) which are shut in every tick.

    Corridors `closed` for the run have permanently shut doors at both ends; others open and shut at
    random, never in the robot's way.
    """
    places, edge = doorways(world, settings.corridor_m)
    always = np.isin(edge, sorted(closed))
    used = np.flatnonzero(always | chance.happens(settings.door_share, len(edge)))
    end_s = float(drive.time_s[-1]) + 1.0
    ticks = np.arange(0.0, end_s, TICK_S)
    robot = drive.at(ticks)[:, :2]
    shut = np.ones((len(ticks), len(used)), np.bool_)
    for number in np.flatnonzero(~always[used]).tolist():
        middle = 0.5 * (places.a + places.b)[used[number]]
        passing = np.hypot(*(robot - middle).T) < 4 * ASIDE_M
        shut[:, number] = _shut(ticks, end_s, passing, chance)
    return take(places, used), shut


def _shut(ticks: FloatArray, end_s: float, passing: BoolArray, chance: Chance) -> BoolArray:
    """(t,) when a door is shut; passing: for every tick whether the robot is near."""
    stays = chance.uniform(*DOOR_STAYS_S, int(end_s / DOOR_STAYS_S[0]) + 2)
    turns = np.concatenate([[0.0], np.cumsum(stays)])
    first = int(chance.one_happens(0.5))
    shut = np.searchsorted(turns, ticks, side="right") % 2 == first
    clear = np.ones(2 * int(WAY_CLEAR_S / TICK_S) + 1)
    return np.asarray(shut & (np.convolve(passing, clear, mode="same") == 0))


def _people_seen(scene: _Scene, time_s: float, robot: FloatArray) -> FloatArray:
    """(p, 2) where people are, interpolated linearly, without those in the robot's way."""
    rows = [[np.interp(time_s, times, axis) for axis in xy.T] for times, xy in scene.people]
    seen: FloatArray = quantised(np.array(rows).reshape(-1, 2), 20)
    return np.asarray(seen[np.hypot(*(seen - robot).T) >= 2 * ASIDE_M])


def _wander(
    world: World, closed: set[int], end_s: float, chance: Chance
) -> tuple[FloatArray, FloatArray]:
    """The random walk of a person from junction to junction, with a speed of its own: times (k,)
    [s] and points (k, 2)."""
    here, came_by = chance.index(len(world)), -1
    speed = chance.one_uniform(*WALKING_M_PER_S)
    time_s, points, now = [], [], 0.0
    while now <= end_s:
        open_ends = [(e, v) for e, v, _ in world.ends(here) if e not in closed]
        onwards = [end for end in open_ends if end[0] != came_by] or open_ends
        if not onwards:
            return np.zeros(1), world.xy[here : here + 1]
        edge, there = onwards[chance.index(len(onwards))]
        path, length = world.path_from(edge, here), float(world.length[edge])
        way = np.linspace(0.0, length, max(2, int(length / 0.5)))
        middle = polyline_at(path, way)
        step = np.diff(middle, axis=0, append=2 * middle[-1:] - middle[-2:-1])
        right = np.column_stack([step[:, 1], -step[:, 0]]) / np.hypot(*step.T)[:, None]
        time_s.append(now + way / speed)
        points.append(middle + ASIDE_M * right)
        now += length / speed + 1e-3
        here, came_by = there, edge
    return np.concatenate(time_s), np.concatenate(points)
