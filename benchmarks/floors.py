"""Floors of many kinds of building, drawn by chance: free cells, row 0 at the smallest y."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from skimage.draw import polygon

from topobatch.topology.arrays import BoolArray

CELL_M = 0.05
WALL_M, DOOR_M = 0.15, 0.95


class Plan:
    """Cells of a floor, all solid at first."""

    def __init__(self, width_m: float, depth_m: float) -> None:
        self.free: BoolArray = np.zeros((round(depth_m / CELL_M), round(width_m / CELL_M)), bool)

    def box(self, x: float, y: float, to_x: float, to_y: float, free: bool = True) -> None:
        """Make the cells of a rectangle [m] free, or solid."""
        a, b, c, d = (max(round(m / CELL_M), 0) for m in (x, y, to_x, to_y))
        self.free[b:d, a:c] = free

    def solid(self, x: float, y: float, width: float, depth: float) -> None:
        """Put a thing there [m]."""
        self.box(x, y, x + width, y + depth, free=False)

    def area(self, corners: np.ndarray) -> None:
        """Make the cells of a polygon (k, 2) [m] free."""
        rows, columns = polygon(corners[:, 1] / CELL_M, corners[:, 0] / CELL_M, self.free.shape)
        self.free[rows, columns] = True

    def way(self, a: np.ndarray, b: np.ndarray, width: float) -> None:
        """Make a corridor [m] free."""
        along = (b - a) / np.hypot(*(b - a)) * width / 2
        aside = np.array([-along[1], along[0]])
        self.area(
            np.stack([a - along + aside, b + along + aside, b + along - aside, a - along - aside])
        )

    def rooms(
        self,
        hall: tuple[float, float],
        at: float,
        depth: float,
        flip: bool,
        rng: np.random.Generator,
    ) -> None:
        """A row of rooms [m] beside a hall, most with a door: along x beside y = at, towards larger
        y if depth > 0; flip: along y beside x = at."""
        x, out = hall[0], np.sign(depth)
        while x < hall[1] - 2.5:
            wide = min(rng.choice([3.0, 3.0, 3.6, 4.8, 6.0]), hall[1] - x)
            parts = [(x + WALL_M, x + wide, at + out * WALL_M, at + depth)]
            if rng.random() < 0.65:
                door = rng.uniform(x + 0.3, x + wide - 1.2)
                parts.append((door, door + DOOR_M, at - out * 0.2, at + out * 0.3))
            for low, high, *beside in parts:
                near, far = sorted(beside)
                self.box(*((near, low, far, high) if flip else (low, near, high, far)))
            x += wide


def museum(rng: np.random.Generator) -> Plan:
    """Halls beside each other with wide openings, and cases in them."""
    xs, ys = (np.cumsum([0.0, *rng.uniform(7, most, n)]) for most, n in ((14, 5), (12, 4)))
    plan = Plan(xs[-1] + 1, ys[-1] + 1)
    for x, to_x in pairwise(xs):
        for y, to_y in pairwise(ys):
            plan.box(x + 0.3, y + 0.3, to_x, to_y)
            for line, low, high, flip in ((to_x, y, to_y, True), (to_y, x, to_x, False)):
                if rng.random() < 0.75 and line not in (xs[-1], ys[-1]):
                    half = rng.uniform(0.7, 1.7)
                    middle = rng.uniform(low + half + 0.8, high - half - 0.8)
                    ends = (line - 0.2, middle - half, line + 0.5, middle + half)
                    plan.box(*(ends if flip else (ends[1], ends[0], ends[3], ends[2])))
            for _ in range(rng.integers(0, 4)):
                size = rng.uniform(0.6, 2.2, 2)
                plan.solid(*rng.uniform([x + 1.6, y + 1.6], [to_x - 3.9, to_y - 3.9]), *size)
    return plan


def fair(rng: np.random.Generator) -> Plan:
    """A foyer with pillars, two large halls, stands along aisles."""
    plan = Plan(95, 62)
    for box in ((1, 1, 94, 9), (1, 9.5, 44, 60), (45, 9.5, 94, 60), (43, 30, 46, 36)):
        plan.box(*box)
    for x in (10, 22, 34, 52, 64, 78, 88):
        plan.box(x, 8, x + rng.uniform(2, 4), 10)
    for hall in (1.0, 45.0):
        x = hall + 4
        while x < hall + 38:
            y = 14.0
            while y < 50:
                width, depth = rng.uniform(3, 6), rng.uniform(3, 9)
                if rng.random() < 0.75:
                    plan.solid(x, y, width, depth)
                y += depth + rng.uniform(2.2, 4)
            x += 6 + rng.uniform(2.2, 4)
    for x in np.arange(6, 92, 8.0):
        for y in (3.0, 20.0, 40.0):
            plan.solid(x, y, 0.5, 0.5)
    return plan


def university(rng: np.random.Generator) -> Plan:
    """A ring of corridors with one across, rooms on both sides of each."""
    plan = Plan(70, 48)
    halls = ((6, 6, 64, 8.4), (6, 38, 64, 40.4), (6, 6, 8.4, 40.4), (61.6, 6, 64, 40.4))
    for hall in (*halls, (34, 6, 36.2, 40.4)):
        plan.box(*hall)
    for ends in ((9, 33), (37, 61)):
        plan.rooms(ends, 8.4, 5.0, False, rng)
        plan.rooms(ends, 38, -5.0, False, rng)
    plan.rooms((6, 64), 6, -4.6, False, rng)
    plan.rooms((6, 64), 40.4, 4.6, False, rng)
    for at, depth in ((8.4, 5.0), (34, -5.0), (36.2, 5.0), (61.6, -5.0)):
        plan.rooms((14, 32), at, depth, True, rng)
    plan.rooms((6, 40), 6, -4.6, True, rng)
    plan.rooms((6, 40), 64, 4.6, True, rng)
    return plan


def garage(rng: np.random.Generator) -> Plan:
    """One large room, pillars in a raster, cars along two sides."""
    plan = Plan(60, 34)
    plan.box(1, 1, 59, 33)
    for x in np.arange(6, 58, 7.5):
        for y in (6.5, 12, 22, 27.5):
            plan.solid(x, y, 0.45, 0.45)
    plan.solid(26, 14, 8, 6)
    plan.box(29, 14.3, 31.5, 19.7)
    plan.box(31, 16, 34.3, 17.2)
    plan.solid(44, 12.5, 15, 0.5)
    for _ in range(rng.integers(8, 16)):
        plan.solid(rng.choice(np.arange(2.5, 56, 2.5)), rng.choice([1.3, 28.3]), 1.9, 4.4)
    return plan


def shop(rng: np.random.Generator) -> Plan:
    """Rows of shelves, some with a gap, and tills."""
    plan = Plan(52, 36)
    plan.box(1, 1, 51, 35)
    for x in np.arange(5, 44, 3.2):
        begin, end = rng.uniform(7, 9), rng.uniform(24, 27)
        plan.solid(x, begin, 1, end - begin)
        if rng.random() < 0.6:
            gap = rng.uniform(14, 18)
            plan.box(x, gap, x + 1, gap + 1.8)
    plan.solid(6, 1, 24, 0.8)
    plan.solid(40, 29, 11, 0.4)
    plan.box(44, 28.8, 46, 29.8)
    for x in np.arange(8, 36, 2.4):
        plan.solid(x, 30.5, 0.7, 2.5)
    return plan


def cubicles(rng: np.random.Generator) -> Plan:
    """An open office: cubicles in a raster, some missing, desks in most, three rooms."""
    plan = Plan(46, 30)
    plan.box(1, 1, 45, 29)
    for x in np.arange(5, 38, 6.2):
        for y in np.arange(4.5, 24, 5.2):
            if rng.random() < 0.12:
                continue
            plan.solid(x, y, 4.4, WALL_M)
            for wall in (0.0, 2.2, 4.25):
                plan.solid(x + wall, y, WALL_M, 3.4)
            for desk in (0.3, 2.5):
                if rng.random() < 0.8:
                    plan.solid(x + desk, y + 0.2, 1.5, 0.7)
    for x, y, wide, deep in (
        (36, 18, 0.2, 11),
        (36, 18, 9, 0.2),
        (1, 24.8, 13, 0.2),
        (14, 24.8, 0.2, 4.2),
    ):
        plan.solid(x, y, wide, deep)
    plan.box(39, 17.8, 40.1, 18.4)
    plan.box(6, 24.6, 7.1, 25.2)
    return plan


def old(rng: np.random.Generator) -> Plan:
    """Corridors at any angle, of bare walls, with rooms behind short passages."""
    plan = Plan(64, 44)
    ring = np.array([(8, 8), (30, 5), (54, 10), (58, 26), (40, 36), (16, 34), (6, 22)], float)
    ring += rng.uniform(-0.6, 0.6, ring.shape)
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        plan.way(a, b, rng.uniform(1.6, 2.8))
        long = np.hypot(*(b - a))
        along = (b - a) / long
        at = 3.0
        while at < long - 7:
            wide, deep = rng.uniform(3, 6), rng.uniform(3, 4.5)
            out = np.array([-along[1], along[0]]) * (-1 if rng.random() < 0.7 else 1)
            corner = a + along * at + 1.7 * out
            askew = along * (wide + rng.uniform(-0.5, 0.5)) + deep * out
            plan.area(
                np.stack([corner, corner + wide * along, corner + askew, corner + deep * out])
            )
            door = corner + wide / 2 * along
            plan.way(door + 0.6 * out, door - out, 0.9)
            at += wide + rng.uniform(0.4, 2)
    plan.way(ring[1], ring[4], 2.0)
    plan.way(ring[6], ring[3], 1.8)
    return plan


def hospital(rng: np.random.Generator) -> Plan:
    """A long corridor with four wings of one design on either side."""
    plan = Plan(90, 40)
    plan.box(2, 18, 88, 20.6)
    for x in (10.0, 32.0, 54.0, 76.0):
        plan.box(x, 3, x + 2.4, 37)
        for ends in ((3.0, 17.5), (22.0, 36.5)):
            plan.rooms(ends, x, -5.2, True, rng)
            plan.rooms(ends, x + 2.4, 5.2, True, rng)
    plan.box(20, 20.6, 30, 27)
    plan.box(64, 11, 74, 18)
    return plan


def home(rng: np.random.Generator) -> Plan:
    """Five rooms with furniture."""
    width, depth = rng.uniform(10, 14), rng.uniform(8, 11)
    plan = Plan(width + 2, depth + 2)
    east, north = 1 + width, 1 + depth
    plan.box(1, 1, east, north)
    x, y = 1 + width * rng.uniform(0.35, 0.6), 1 + depth * rng.uniform(0.4, 0.6)
    right, inner = 1 + depth * rng.uniform(0.3, 0.7), 1 + width * rng.uniform(0.75, 0.85)
    wall = 0.12
    plan.solid(x, 1, wall, depth)
    plan.solid(1, y, x - 1, wall)
    plan.solid(x, right, east - x, wall)
    plan.solid(inner, right, wall, north - right)
    for line, low, high, flip in (
        (x, 1, min(y, right), True),
        (x, max(y, right) + 0.2, north, True),
        (y, 1, x, False),
        (right, x, inner, False),
        (inner, right, north, True),
    ):
        at = rng.uniform(low + 0.4, high - 1.3)
        door = (line - 0.1, at, line + wall + 0.1, at + 0.85)
        plan.box(*(door if flip else (door[1], door[0], door[3], door[2])))
    for _ in range(9):
        size = rng.permutation([rng.uniform(0.5, 1.9), rng.uniform(0.5, 0.9)])
        at = rng.uniform(1, [east - size[0], north - size[1]])
        if rng.random() < 0.5:  # along a wall
            at[0] = rng.choice([1.0, east - size[0], x + wall, x - size[0]])
        else:
            at[1] = rng.choice([1.0, north - size[1], y + wall])
        plan.solid(at[0], at[1], size[0], size[1])
    return plan


KINDS = (museum, fair, university, garage, shop, cubicles, old, hospital, home)


def drawn(kinds: list[str], worlds: int, seed: int) -> Iterator[tuple[str, BoolArray]]:
    """Floors of these kinds, by name, with a solid rim."""
    for number, kind in enumerate(KINDS):
        for k in range(worlds if kind.__name__ in kinds else 0):
            plan = kind(np.random.default_rng([seed + k, number]))
            yield f"{kind.__name__}-{k}", np.pad(plan.free, 20)
