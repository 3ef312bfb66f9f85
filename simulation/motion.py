"""The robot's motion along its legs: true path and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.polyline import way_of
from ..topology.se2 import wrap
from .chance import Chance, quantised
from .settings import MotionSettings
from .walk import Leg
from .world import World, polyline_at, polyline_length

STEP_M = 0.05
"""Spacing of the planned path's points."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """The robot's true motion.

    time_s: (k,) ascending from 0; pose: (k, 3) x, y [m], theta [rad, unwrapped] in the world;
    way_m: (k,) distance along the planned path. visit_vertex, visit_way_m: (v,) visits of junctions
    by time. leg_edge, leg_from_m, leg_to_m: (l,) corridors driven from end to end, and their
    interval of the planned path.
    """

    time_s: FloatArray
    pose: FloatArray
    way_m: FloatArray
    visit_vertex: IntArray
    visit_way_m: FloatArray
    leg_edge: IntArray
    leg_from_m: FloatArray
    leg_to_m: FloatArray

    def at(self, time_s: FloatArray) -> FloatArray:
        """(m, 3) true poses at any times, theta unwrapped."""
        columns = [np.interp(time_s, self.time_s, column) for column in self.pose.T]
        return quantised(np.column_stack(columns), 26)

    def first_at(self, way_m: FloatArray) -> FloatArray:
        """(m,) times at which the robot first reached a distance along its planned path."""
        return self._when(way_m, np.searchsorted(self.way_m, way_m, side="left"))

    def last_at(self, way_m: FloatArray) -> FloatArray:
        """(m,) times at which it was last there: while it turns on the spot the distance does not
        change."""
        return self._when(way_m, np.searchsorted(self.way_m, way_m, side="right"))

    def _when(self, way_m: FloatArray, after: IntArray) -> FloatArray:
        """Linear interpolation between the samples `after` - 1 and `after`, clamped to the ends."""
        j = np.clip(after, 1, len(self.way_m) - 1)
        span = np.maximum(self.way_m[j] - self.way_m[j - 1], 1e-9)
        part = np.clip((way_m - self.way_m[j - 1]) / span, 0.0, 1.0)
        time = self.time_s[j - 1] + part * (self.time_s[j] - self.time_s[j - 1])
        return quantised(time, 20)


@dataclass(slots=True)
class _Plan:
    """The planned path in pieces between reversals, with its visits and legs."""

    pieces: list[list[FloatArray]]
    visit_vertex: list[int]
    visit_way_m: list[float]
    legs: list[tuple[int, float, float]]
    way_m: float = 0.0


def drive(world: World, legs: list[Leg], settings: MotionSettings, chance: Chance) -> Drive:
    """Drive consecutive legs. O(path length / STEP_M), vectorised."""
    plan = _planned(world, legs)
    ways, points = _sampled(plan)
    parts = [_smoothed(p, settings, chance) for p in points]
    way, pose = _joined(ways, parts, chance)
    time = _clock(way, pose, np.array(plan.visit_way_m), settings, chance)
    edges, starts, ends = zip(*plan.legs, strict=True)
    return Drive(
        time_s=time,
        pose=pose,
        way_m=way,
        visit_vertex=np.array(plan.visit_vertex, np.int64),
        visit_way_m=np.array(plan.visit_way_m),
        leg_edge=np.array(edges, np.int64),
        leg_from_m=np.array(starts),
        leg_to_m=np.array(ends),
    )


def _planned(world: World, legs: list[Leg]) -> _Plan:
    """The corridors' centre lines in order, with a new piece wherever the robot turns round."""
    plan = _Plan([[]], [legs[0].source], [0.0], [])
    came_by: int | None = None
    for leg in legs:
        path = world.path_from(leg.edge, leg.source)
        if came_by == leg.edge:
            plan.pieces.append([])
        if leg.turn_back_m is not None:
            out = _cut(path, leg.turn_back_m)
            plan.pieces[-1].append(out)
            plan.pieces.append([out[::-1]])
            plan.pieces.append([])
            plan.way_m += 2 * leg.turn_back_m
            plan.visit_vertex.append(leg.source)
            plan.visit_way_m.append(plan.way_m)
            came_by = None
            continue
        plan.pieces[-1].append(path)
        start = plan.way_m
        plan.way_m += float(world.length[leg.edge])
        plan.legs.append((leg.edge, start, plan.way_m))
        plan.visit_vertex.append(leg.target)
        plan.visit_way_m.append(plan.way_m)
        came_by = leg.edge
    return plan


def _cut(path: FloatArray, way_m: float) -> FloatArray:
    """The first `way_m` of a polyline."""
    at = way_of(path)
    return np.concatenate([path[at < way_m], polyline_at(path, np.array([way_m]))])


def _sampled(plan: _Plan) -> tuple[list[FloatArray], list[FloatArray]]:
    """For each piece the planned distance and points about every STEP_M."""
    ways, points, start = [], [], 0.0
    for piece in plan.pieces:
        path = np.concatenate([piece[0], *[part[1:] for part in piece[1:]]])
        length = sum(polyline_length(part) for part in piece)
        way = np.linspace(0.0, length, int(np.ceil(length / STEP_M)) + 1)
        ways.append(start + way)
        points.append(polyline_at(path, way))
        start += length
    return ways, points


def _smooth(values: FloatArray, width: float) -> FloatArray:
    """Gaussian smoothing of a column with constant padding; width in samples."""
    reach = int(np.ceil(4 * width))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    padded = np.concatenate([np.repeat(values[:1], reach), values, np.repeat(values[-1:], reach)])
    smoothed: FloatArray = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return smoothed


def _wander(count: int, sigma: float, width: float, chance: Chance) -> FloatArray:
    """(count,) Gaussian noise of standard deviation `sigma`, smoothed over `width` samples."""
    if sigma == 0:
        return np.zeros(count)
    noise = chance.normal(1.0, count)
    gain = float(sigma * np.sqrt(2 * width * np.sqrt(np.pi)))
    return gain * _smooth(noise, width)


def _smoothed(xy: FloatArray, settings: MotionSettings, chance: Chance) -> FloatArray:
    """The path with corners smoothed and deviations added."""
    columns = [
        _smooth(column, settings.corner_m / STEP_M)
        + _wander(len(column), settings.wobble_m, 1.2 / STEP_M, chance)
        for column in xy.T
    ]
    return quantised(np.column_stack(columns), 20)


def _joined(
    ways: list[FloatArray], parts: list[FloatArray], chance: Chance
) -> tuple[FloatArray, FloatArray]:
    """The pieces one after another, with turns on the spot between them: ways (k,) and poses (k,
    3).

    Within a piece the heading is that of the path; between two it turns, half a turn either way,
    while the position moves to the next piece's start, in steps by which a point half a metre from
    the robot's centre moves STEP_M.
    """
    out_way, out_xy, out_theta = [], [], []
    theta_end: float | None = None
    for i, (way, xy) in enumerate(zip(ways, parts, strict=True)):
        step = np.diff(xy, axis=0)
        theta = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        theta = _smooth(np.append(theta, theta[-1]), 2.0)
        if theta_end is not None:
            turn = float(wrap(theta[0] - theta_end))
            if abs(turn) > 2.5 and chance.one_happens(0.5):
                turn -= float(np.sign(turn)) * 2 * np.pi
            theta = theta + (theta_end + turn - theta[0])
            count = int(abs(turn) * 0.5 / STEP_M) + 2
            t = np.linspace(0.0, 1.0, count + 2)[1:-1, None]
            out_way.append(np.repeat(way[0], count))
            out_xy.append((1 - t) * parts[i - 1][-1] + t * xy[0])
            out_theta.append(theta_end + turn * t[:, 0])
        out_way.append(way)
        out_xy.append(xy)
        out_theta.append(theta)
        theta_end = float(theta[-1])
    way = np.concatenate(out_way)
    pose = np.column_stack([np.concatenate(out_xy), np.concatenate(out_theta)])
    return quantised(way, 20), quantised(pose, 20)


def _clock(
    way: FloatArray, pose: FloatArray, visits: FloatArray, settings: MotionSettings, chance: Chance
) -> FloatArray:
    """(k,) time of every sample [s]: varying cruising speed, limited turn rate, and stops at some
    of the visits, distances along the way (v,) [m]."""
    cruise = chance.one_uniform(settings.slowest_m_per_s, settings.fastest_m_per_s)
    pace = 1 + _wander(len(way) - 1, 0.12, 2.0 / STEP_M, chance)
    speed = np.clip(cruise * pace, 0.5 * cruise, 1.2 * cruise)
    step, turn = np.hypot(*np.diff(pose[:, :2], axis=0).T), np.abs(np.diff(pose[:, 2]))
    needed = np.maximum(step / speed, turn / settings.turn_rate_rad_per_s)
    stops = visits[chance.happens(settings.stop_rate, len(visits))]
    at = np.searchsorted(way, stops + chance.around(2.0, len(stops))) - 1
    np.add.at(needed, np.clip(at, 0, len(needed) - 1), chance.uniform(2.0, 8.0, len(stops)))
    return np.concatenate([[0.0], np.cumsum(quantised(np.maximum(needed, 2.0**-14), 20))])
