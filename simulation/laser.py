"""The simulated laser: scans of a world from the robot's true pose, with doors that open and close
and people who walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ..topology.columns import take
from ..topology.frozen import freeze
from ..topology.se2 import compose
from .chance import Chance, quantised
from .motion import Drive
from .settings import LaserSettings
from .walls import Segments, doorways, walls_of
from .world import World, polyline_at

SCANS_AT_ONCE = 8
"""Scans cast together; with more, the set of walls in reach of any of them grows."""

PANEL_M = 2.0
"""Length of wall panels of one material."""

GLASS_SEEN = 0.97
"""Glass reflects a beam if the cosine of its angle to the normal is at least this."""

PERSON_M = 0.2
"""Radius of a person at the laser's height."""

GRID_BITS = 8
"""Ranges are multiples of 2^-8 m (4 mm), a lidar's typical resolution: logs compress better."""

NOTHING = -1
"""Segment of a beam that hits none."""

DOOR_STAYS_S = (20.0, 90.0)
"""Range of the time between changes of a door."""

WAY_CLEAR_M = 1.2
"""A door is open while the robot is within this distance, and for WAY_CLEAR_S before and after."""

WAY_CLEAR_S = 6.0
"""See WAY_CLEAR_M."""

WALKING_M_PER_S = (0.8, 1.5)
"""Range of walking speeds."""

ASIDE_M = 0.3
"""People walk this far to the right of the corridor's centre line."""

STEPS_ASIDE_M = 0.6
"""People within this distance of the robot's centre are removed from its scan."""

TICK_S = 0.25
"""Time step of doors."""


@dataclass(frozen=True, slots=True, eq=False)
class Doors:
    """Doors and when they are shut.

    walls: (d,) segments; edge, vertex: (d,) the corridor and the end of it at which each is; door,
    from_s, to_s: (k,) half-open intervals in which door `door` is shut.
    """

    walls: Segments
    edge: IntArray
    vertex: IntArray
    door: IntArray
    from_s: FloatArray
    to_s: FloatArray

    def shut(self, time_s: FloatArray) -> BoolArray:
        """(n, d) which doors are shut at each time."""
        out = np.zeros((len(time_s), len(self.walls)), np.bool_)
        for door, from_s, to_s in zip(self.door, self.from_s, self.to_s, strict=True):
            out[:, door] |= (time_s >= from_s) & (time_s < to_s)
        return out


People = list[tuple[FloatArray, FloatArray]]
"""For each person ascending times (k,) [s] and the points (k, 2) at them."""


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """Scans as recorded: time_s (n,) of the first beam; ranges_m (n, m) float32, inf without an
    echo; angles_rad (m,) ascending, in the laser's frame.

    doors: the world's doors and when they were shut, in true time.
    """

    time_s: FloatArray
    ranges_m: Float32Array
    angles_rad: FloatArray
    settings: LaserSettings
    doors: Doors

    def __post_init__(self) -> None:
        freeze(self, np.float64, time_s=(None,), angles_rad=(None,))
        if self.ranges_m.shape != (len(self.time_s), len(self.angles_rad)):
            raise ValueError("one range per scan and beam is needed")
        self.ranges_m.flags.writeable = False

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Everything that beams can hit; panel_at: (s,) index of each wall's first panel in `glass`."""

    walls: Segments
    glass: BoolArray
    panel_at: IntArray
    doors: Doors
    people: People


def scans(
    world: World, drive: Drive, closed: set[int], settings: LaserSettings, chance: Chance
) -> Scans:
    """The laser's scans during a drive. O(scans × beams × walls in reach), vectorised."""
    scene = _scene(world, drive, closed, settings, chance)
    half = np.radians(0.5 * settings.view_deg)
    angles: FloatArray = np.linspace(-half, half, settings.beams).round(9)
    count = int((float(drive.time_s[-1]) - settings.sweep_s) * settings.rate_hz)
    start = quantised((np.arange(count) + chance.uniform(0.0, 0.2, count)) / settings.rate_hz, 20)
    rows = [
        _cast(drive, start[k : k + SCANS_AT_ONCE], angles, settings, scene)
        for k in range(0, count, SCANS_AT_ONCE)
    ]
    ranges = np.concatenate(rows) if rows else np.zeros((0, settings.beams))
    seen = ranges + chance.normal(settings.noise_m, ranges.size).reshape(ranges.shape)
    seen[chance.happens(settings.lost_rate, ranges.size).reshape(ranges.shape)] = np.inf
    finite = np.isfinite(seen)
    seen[finite] = quantised(np.maximum(seen[finite], settings.range_min_m), GRID_BITS)
    # Readers treat ranges of range_max and more as no echo.
    seen[seen >= settings.range_max_m] = np.inf
    return Scans(start, seen.astype(np.float32), angles, settings, scene.doors)


def _scene(
    world: World, drive: Drive, closed: set[int], settings: LaserSettings, chance: Chance
) -> _Scene:
    walls = walls_of(world, settings.corridor_m)
    panels = np.floor(walls.length / PANEL_M).astype(np.int64) + 1
    hinges = doorways(world, settings.corridor_m)
    glass = chance.happens(settings.glass_share, int(panels.sum()))
    doors = hang_doors(hinges, drive, closed, settings.door_share, chance)
    crowd = round(settings.people_per_100_m * float(world.length.sum()) / 100)
    end_s = float(drive.time_s[-1]) + 1.0
    people = [_wander(world, closed, end_s, chance) for _ in range(crowd)]
    return _Scene(walls, glass, np.cumsum(panels) - panels, doors, people)


def _cast(
    drive: Drive, start_s: FloatArray, angles: FloatArray, settings: LaserSettings, scene: _Scene
) -> FloatArray:
    """(n, m) true ranges of a few consecutive scans, inf without a hit."""
    beam_s = np.linspace(0.0, settings.sweep_s, settings.beams)
    robot = drive.at((start_s[:, None] + beam_s).ravel())
    laser = compose(robot, np.array(settings.mount))
    turn = -angles if settings.upside_down else angles
    heading = laser[:, 2] + np.tile(turn, len(start_s))
    direction = quantised(np.column_stack([np.cos(heading), np.sin(heading)]), 40)
    origin = quantised(laser[:, :2], 26)
    low = origin.min(axis=0) - settings.range_max_m
    high = origin.max(axis=0) + settings.range_max_m
    walls = _reached(scene.walls, low, high)
    way, wall, at = cast_at_segments(origin, direction, take(scene.walls, walls))
    doors = _reached(scene.doors.walls, low, high)
    shut = np.repeat(scene.doors.shut(start_s)[:, doors], len(beam_s), axis=0)
    to_door, _, _ = cast_at_segments(origin, direction, take(scene.doors.walls, doors), shut)
    people = np.repeat(_people_seen(scene.people, start_s, drive), len(beam_s), axis=0)
    moving = np.minimum(to_door, cast_at_circles(origin, direction, people, PERSON_M))
    # A beam lost in glass hits nothing behind it: people there are hidden by other walls as well.
    lost = (way <= moving) & _lost_in_glass(direction, wall, at, walls, scene)
    return np.where(lost, np.inf, np.minimum(way, moving)).reshape(len(start_s), -1)


def _reached(segments: Segments, low: FloatArray, high: FloatArray) -> IntArray:
    """Indices of the segments whose bounding box meets the given box."""
    least, most = np.minimum(segments.a, segments.b), np.maximum(segments.a, segments.b)
    return np.flatnonzero(((least <= high) & (most >= low)).all(axis=1)).astype(np.int64)


def _lost_in_glass(
    direction: FloatArray, wall: IntArray, at: FloatArray, numbers: IntArray, scene: _Scene
) -> BoolArray:
    """(r,) which beams hit glass and give no echo. wall, at: as returned by the cast, among
    `numbers`."""
    met = wall != NOTHING
    lost = np.zeros(len(wall), np.bool_)
    number = numbers[wall[met]]
    panel = scene.panel_at[number] + np.floor(at[met] / PANEL_M).astype(np.int64)
    along = (scene.walls.b - scene.walls.a)[number] / scene.walls.length[number, None]
    squarely = np.abs(direction[met, 0] * along[:, 1] - direction[met, 1] * along[:, 0])
    lost[met] = scene.glass[panel] & (squarely < GLASS_SEEN)
    return lost


def _people_seen(people: People, time_s: FloatArray, drive: Drive) -> FloatArray:
    """(n, p, 2) positions of people; those in the robot's way are moved out of reach."""
    xy = positions(people, time_s)
    near = np.hypot(*np.moveaxis(xy - drive.at(time_s)[:, None, :2], -1, 0)) < STEPS_ASIDE_M
    xy[near] = 1e9
    return xy


def cast_at_segments(
    origin: FloatArray, direction: FloatArray, segments: Segments, present: BoolArray | None = None
) -> tuple[FloatArray, IntArray, FloatArray]:
    """The first hit of each beam on a set of segments. O(r s), vectorised.

    origin, direction: (r, 2), directions of unit length; present: (r, s) which segments exist for
    which beam. Returns range (r,) [m], inf without a hit; segment (r,), else NOTHING; at (r,)
    distance from the segment's start [m].
    """
    if len(segments) == 0:
        rays = len(origin)
        return np.full(rays, np.inf), np.full(rays, NOTHING, np.int64), np.zeros(rays)
    # o + t d = a + u e, solved for all beams against all segments by Cramer's rule.
    ex, ey = (segments.b - segments.a).T
    ax, ay = segments.a[:, 0] - origin[:, :1], segments.a[:, 1] - origin[:, 1:]
    dx, dy = direction[:, :1], direction[:, 1:]
    cross = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (ax * ey - ay * ex) / cross
        share = (ax * dy - ay * dx) / cross
    met = (way > 0) & (share >= 0) & (share <= 1)
    if present is not None:
        met &= present
    way = np.where(met, way, np.inf)
    rows = np.arange(len(origin))
    first = way.argmin(axis=1)
    nearest = way[rows, first]
    hit = np.isfinite(nearest)
    at = np.where(hit, share[rows, first], 0.0) * segments.length[first]
    return nearest, np.where(hit, first, NOTHING).astype(np.int64), at


def cast_at_circles(
    origin: FloatArray, direction: FloatArray, centre: FloatArray, radius_m: float
) -> FloatArray:
    """(r,) range of each beam to the nearest circle, inf without a hit.

    origin, direction: (r, 2); centre: (r, p, 2), the circles' positions for each beam.
    """
    if centre.shape[1] == 0:
        return np.full(len(origin), np.inf)
    to = centre - origin[:, None]
    along = np.einsum("rpk,rk->rp", to, direction)
    apart2 = np.einsum("rpk,rpk->rp", to, to) - along**2
    half2 = radius_m**2 - apart2
    met = (half2 > 0) & (along > 0)
    way = np.where(met, along - np.sqrt(np.where(met, half2, 0.0)), np.inf)
    return np.asarray(np.where(way > 0, way, np.inf).min(axis=1))


def hang_doors(
    hinges: tuple[Segments, IntArray, IntArray],
    drive: Drive,
    closed: set[int],
    share: float,
    chance: Chance,
) -> Doors:
    """Doors at a random share of the possible places, with the times when they are shut.

    hinges: as returned by `walls.doorways`. Corridors `closed` for the run have permanently shut
    doors at both ends; others open and shut at random, never in the robot's way.
    """
    places, edge, vertex = hinges
    always = np.isin(edge, sorted(closed))
    used = np.flatnonzero(always | chance.happens(share, len(edge)))
    end_s = float(drive.time_s[-1]) + 1.0
    robot = drive.at(np.arange(0.0, end_s, TICK_S))[:, :2]
    spans = []
    for number, place in enumerate(used.tolist()):
        if always[place]:
            spans.append((number, 0.0, end_s))
            continue
        middle = 0.5 * (places.a[place] + places.b[place])
        passing = np.hypot(*(robot - middle).T) < WAY_CLEAR_M
        spans += [(number, *span) for span in _shut_spans(passing, end_s, chance)]
    door, from_s, to_s = np.array(spans, np.float64).reshape(-1, 3).T
    return Doors(
        Segments(places.a[used], places.b[used]),
        edge[used],
        vertex[used],
        door.astype(np.int64),
        quantised(from_s, 10),
        quantised(to_s, 10),
    )


def _shut_spans(passing: BoolArray, end_s: float, chance: Chance) -> list[tuple[float, float]]:
    """Intervals in which a door is shut; passing: for every tick whether the robot is near."""
    stays = chance.uniform(*DOOR_STAYS_S, int(end_s / DOOR_STAYS_S[0]) + 2)
    turns = np.concatenate([[0.0], np.cumsum(stays)])
    ticks = TICK_S * np.arange(len(passing))
    first = int(chance.one_happens(0.5))
    shut = np.searchsorted(turns, ticks, side="right") % 2 == first
    near = int(WAY_CLEAR_S / TICK_S)
    shut &= np.convolve(passing, np.ones(2 * near + 1), mode="same") == 0
    change = np.diff(np.concatenate([[False], shut, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    return [(TICK_S * b, TICK_S * e) for b, e in zip(begins.tolist(), ends.tolist(), strict=True)]


def positions(people: People, time_s: FloatArray) -> FloatArray:
    """(n, p, 2) where people are at each time, interpolated linearly."""
    out = np.empty((len(time_s), len(people), 2))
    for p, (times, points) in enumerate(people):
        for axis in (0, 1):
            out[:, p, axis] = np.interp(time_s, times, points[:, axis])
    return quantised(out, 20)


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
