"""Moving objects in a world: doors that open and close, people who walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import BoolArray, FloatArray, IntArray
from .chance import Chance, quantised
from .motion import Drive
from .walls import Segments
from .world import World, polyline_at

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


People = list[tuple[FloatArray, FloatArray]]
"""For each person ascending times (k,) [s] and the points (k, 2) at them."""


def walk_about(world: World, closed: set[int], count: int, end_s: float, chance: Chance) -> People:
    """`count` people on random walks from junction to junction, each with a speed of its own."""
    return [_wander(world, closed, end_s, chance) for _ in range(count)]


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
