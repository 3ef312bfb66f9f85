"""Walks through a street grid, drawn by hand or at random, with known truth."""

from __future__ import annotations

import itertools

import numpy as np

from topobatch.topology.closure.branches import branches_of
from topobatch.topology.closure.evidence import background
from topobatch.topology.closure.growth import MapState
from topobatch.topology.closure.negative_information import DrivenGround
from topobatch.topology.closure.places import tabulate
from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import NO_BRANCH, Passes
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import compose, wrap
from topobatch.topology.topomap import RunNoise

from ..tracks import passes_at

T0 = 10**18
STEP_M = 0.1
NOISE = RunNoise(
    along_m_per_sqrt_m=0.01,
    heading_rad_per_sqrt_m=0.008,
    heading_rad_per_sqrt_rad=0.01,
    centre_m=0.05,
    branch_rad=0.04,
)
EVERY = 16
"""Odometry rows from one pass to the next, at half a metre each."""


def grid_world(rows, columns, rng=None):
    """Junctions of a street grid, and for each its neighbours."""
    gaps = (rng.uniform(3.5, 8.0, 40) if rng is not None else np.full(40, 5.0)).reshape(2, 20)
    x, y = np.cumsum(gaps[0][:columns]), np.cumsum(gaps[1][:rows])
    xy = {(r, c): np.array([x[c], y[r]]) for r in range(rows) for c in range(columns)}
    return xy, side_by_side(xy)


def side_by_side(xy):
    """For each junction (row, column) its neighbours."""
    steps = ((0, 1), (1, 0), (0, -1), (-1, 0))
    return {(r, c): [(r + dr, c + dc) for dr, dc in steps if (r + dr, c + dc) in xy] for r, c in xy}


def aisles(count, length=40.0, spacing=3.0):
    """Rows of one length, joined at both ends: every one looks like the next."""
    xy = {(r, c): np.array([spacing * c, length * r]) for r in (0, 1) for c in range(count)}
    return xy, side_by_side(xy)


def wander(beside, steps, rng):
    """A random route that seldom turns back."""
    route = [(0, 0)]
    while len(route) < steps:
        options = [v for v in beside[route[-1]] if len(route) < 2 or v != route[-2]]
        route.append(options[rng.integers(len(options))] if options else route[-2])
    return route


def record(world, route, rng=None, *, noise=NOISE, bias=0.0, unseen=(), breaks_before=()):
    """Odometry and passes of a drive through the junctions of a route.

    With an rng, the odometry drifts and the passes are off by `noise`. bias: [rad/m] that the
    odometry turns too far; unseen: steps of the route at which the detector is blind;
    breaks_before: steps before which the odometry jumps.
    Returns odometry, passes, and the junction of each pass.
    """
    xy, beside = world
    points, at = [xy[route[0]]], [0]
    for a, b in itertools.pairwise(route):
        n = max(round(float(np.hypot(*(xy[b] - xy[a])) / STEP_M)), 1)
        points += [xy[a] + (xy[b] - xy[a]) * k / n for k in range(1, n + 1)]
        at.append(len(points) - 1)
    if len(points) == 1:
        points.append(points[0] + [STEP_M, 0.0])
    true = np.array(points)
    step = np.diff(true, axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    heading = np.append(heading, heading[-1])
    pose = np.column_stack([true, heading])
    if rng is not None:
        ds = np.hypot(*step.T)
        turn = wrap(np.diff(heading)) + bias * ds
        turn = turn + rng.normal(size=len(ds)) * np.hypot(
            noise.heading_rad_per_sqrt_m * np.sqrt(ds),
            noise.heading_rad_per_sqrt_rad * np.sqrt(np.abs(turn)),
        )
        ds = ds + rng.normal(size=len(ds)) * noise.along_m_per_sqrt_m * np.sqrt(ds)
        theta = heading[0] + np.concatenate([[0.0], np.cumsum(turn)])
        move = ds[:, None] * np.column_stack([np.cos(theta[:-1]), np.sin(theta[:-1])])
        pose = np.column_stack(
            [true[0] + np.concatenate([[[0.0, 0.0]], np.cumsum(move, axis=0)]), theta]
        )
    breaks = []
    for k in breaks_before:
        row = at[k] - 15
        breaks.append(row)
        pose[row:] = compose(np.array([50.0, 3.0, 1.0]), pose[row:])
    time_ns = T0 + np.arange(len(pose)) * 100_000_000
    odometry = Odometry(time_ns, pose * [1, 1, 0] + [0, 0, 1] * wrap(pose), np.array(breaks, int))
    rows = [k for k in range(len(route)) if k not in set(unseen)]
    centre, branches, entry, exit_ = [], [], [], []
    for k in rows:
        here, turned = route[k], pose[at[k], 2] - heading[at[k]]
        out = [xy[v] - xy[here] for v in beside[here]]
        angle = np.array([np.arctan2(d[1], d[0]) for d in out])
        seen = wrap(angle + turned + (rng.normal(0, noise.branch_rad, len(angle)) if rng else 0))
        order = np.argsort(seen)
        offset = rng.normal(0, noise.centre_m, 2) if rng is not None else 0.0
        centre.append(pose[at[k], :2] + offset)
        branches.append(seen[order])
        # An unseen neighbour does not change the branch that was driven.
        for ends, other in ((entry, k - 1), (exit_, k + 1)):
            if 0 <= other < len(route):
                d = xy[route[other]] - xy[here]
                off = np.abs(wrap(angle[order] - np.arctan2(d[1], d[0])))
                ends.append(int(off.argmin()))
            else:
                ends.append(NO_BRANCH)
    when = time_ns[[at[k] for k in rows]]
    found = {"entry": np.array(entry), "exit": np.array(exit_), "messages": np.full(len(rows), 9)}
    passes = passes_at(when, centre, branches, **found)
    return odometry, passes, [route[k] for k in rows]


def partition(labels):
    """Labels as numbers by first appearance: equal partitions give equal arrays."""
    seen: dict = {}
    return np.array([seen.setdefault(v, len(seen)) for v in labels])


def scene_of(reckoning, estimate):
    """Dead reckoning laid out, every pass a place of its own."""
    places = tabulate(reckoning, np.arange(len(reckoning)), estimate.pose[:, 2])
    common = background(reckoning, reckoning.noise)
    return MapState(reckoning, places, estimate.xy, common, branches_of(places, common))


def noisy_square(laps: int, noise: RunNoise, seed: int) -> tuple[Odometry, Passes, np.ndarray]:
    """Laps round a square of eight junctions, 8 m apart, with errors of exactly that noise."""
    rng = np.random.default_rng(seed)
    count = 8 * EVERY * laps + 1
    row = np.arange(count)
    heading = np.pi / 2 * (row // (2 * EVERY))
    turned = np.concatenate([[0.0], np.diff(heading)])
    way = np.full(count, 0.5)
    spread = noise.heading_rad_per_sqrt_m**2 * way + noise.heading_rad_per_sqrt_rad**2 * turned
    off = np.cumsum(rng.normal(0, np.sqrt(spread)))
    step = 0.5 * np.column_stack([np.cos(heading + off), np.sin(heading + off)])
    step += rng.normal(0, noise.along_m_per_sqrt_m * np.sqrt(0.5), step.shape)
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)[:-1]])
    pose = np.column_stack([xy, heading + off])
    odometry = Odometry(row * 10**8, pose, np.zeros(0, np.int64))
    at = row[::EVERY]
    p = len(at)
    branches = Ragged.from_rows([off[k] + np.array([0.0, np.pi / 2, np.pi]) for k in at])
    read = Ragged(branches.offsets, branches.values + rng.normal(0, noise.branch_rad, 3 * p))
    centre = xy[at] + rng.normal(0, noise.centre_m, (p, 2))
    passes = passes_at(odometry.time_ns[at], centre, read)
    return odometry, passes, np.arange(p) % 8


def no_ground(pairs):
    """Pairs of places around which nothing was driven."""
    return DrivenGround(np.zeros((pairs, 2, 0, 2)), np.zeros((pairs, 2, 0)))
