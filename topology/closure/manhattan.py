"""Manhattan worlds: buildings whose corridors meet at right angles (the paper's rectilinear
worlds).

The branches of a single pass determine the robot's heading up to quarter turns, and the odometry
determines which quarter, so that heading errors do not accumulate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..matching.likelihood import LIKELIHOOD
from ..passes import ONE_WAY_RAD, Passes
from ..ragged import numbered
from ..se2 import wrap
from .dead_reckoning import DeadReckoning, dead_reckoning_covariance


@dataclass(frozen=True, slots=True)
class RectilinearSettings:
    """When a building counts as rectilinear."""

    least_share: float = 0.9
    """Least share of the angles between branches of a pass that are near quarter turns, by the rule
    of succession, which needs at least eight angles. Of uniformly distributed angles a third are
    near."""
    spread_rad: float = 0.02
    """1 sigma of a corridor's deviation from the grid of its building [rad], before
    `variance_components` estimates it."""
    most_wander: float = 1.15
    """Largest mean χ² of the grid's changes of direction between passes, in variances of the
    odometry's drift: in streets that meet at right angles and bend between, the grid turns more
    than the odometry drifts (0.8 to 2.4 in 150 city walks, 0.6 to 1.2 in 170 of mazes and offices).
    """


RECTILINEAR = RectilinearSettings()


@dataclass(frozen=True, slots=True, eq=False)
class GridHeadings:
    """Passes whose branches determine the rotation from the odometry frame to the map frame.

    The map frame is that of the odometry at the first of them; in each piece of a broken odometry,
    at its first. row: (k,) pass; turn: (k,) [rad], continuous along a piece; axis: (k,) direction
    of the grid in the map frame [rad]; sigma: (k,) 1 sigma of turn [rad], including `spread_rad`,
    the deviation of single corridors from the grid.
    """

    row: IntArray
    turn: FloatArray
    axis: FloatArray
    sigma: FloatArray
    spread_rad: float


def grid_headings(reckoning: DeadReckoning) -> GridHeadings | None:
    """Rotations of the passes by the building's grid; None if the building is not rectilinear."""
    branches = reckoning.passes.branches
    owner = branches.owner
    # Angles between neighbouring branches of a pass, as distance from the next quarter turn.
    same = owner[1:] == owner[:-1]
    off = from_quarter(np.diff(branches.values)[same])
    # The tolerance includes the sensor's noise.
    one = reckoning.noise.branch_rad**2 + RECTILINEAR.spread_rad**2
    tolerance = LIKELIHOOD.gate_sigmas * np.sqrt(2.0 * one)
    near = np.count_nonzero(np.abs(off) < tolerance)
    if tolerance > 0.5 or (near + 1) / (len(off) + 2) < RECTILINEAR.least_share:
        return None
    # Direction of the grid as each pass sees it: mean on the circle of quarter turns.
    count = len(reckoning)
    z = np.bincount(owner, np.cos(4 * branches.values), count) + 1j * np.bincount(
        owner, np.sin(4 * branches.values), count
    )
    n = branches.counts
    row = np.flatnonzero((n > 0) & (np.abs(z) > 0.5 * np.maximum(n, 1)))
    if len(row) < 2:
        return None
    grid = np.angle(z[row]) / 4
    # The grid appears to turn as the odometry drifts, by little from pass to pass.
    step = from_quarter(np.diff(grid))
    sigma = np.sqrt(reckoning.noise.branch_rad**2 / n[row] + RECTILINEAR.spread_rad**2)
    drift = dead_reckoning_covariance(reckoning, row[:-1], row[1:])[:, 2, 2]
    excess = step**2 / (drift + sigma[1:] ** 2 + sigma[:-1] ** 2)
    joined = reckoning.piece[row[:-1]] == reckoning.piece[row[1:]]
    if joined.any() and excess[joined].mean() > RECTILINEAR.most_wander:
        return None
    # Each piece of the odometry has a frame of its own.
    turn = -np.concatenate([[0.0], np.cumsum(step)])
    begin = np.flatnonzero(np.concatenate([[True], ~joined]))
    size = np.diff(begin, append=len(row))
    turn, axis = np.asarray(wrap(turn - np.repeat(turn[begin], size))), np.repeat(grid[begin], size)
    return GridHeadings(row, turn, axis, sigma, RECTILINEAR.spread_rad)


@dataclass(frozen=True, slots=True, eq=False)
class GridCorridors:
    """Straight corridors along the grid of a building, one per drive through a corridor.

    direction: (c,) [rad] in the map frame, with 1 sigma spread_rad (c,); side: (c,) axis of the
    grid that it follows, 0 or 1; corridor, row: (k,) corridor and pass of every pass that lies on
    one, sorted by both; aside: (k,) [m] how far to the left of the corridor's line the pass lies,
    with 1 sigma sigma_m.
    """

    direction: FloatArray
    spread_rad: FloatArray
    side: IntArray
    corridor: IntArray
    row: IntArray
    aside: FloatArray
    sigma_m: float


def grid_corridors(
    reckoning: DeadReckoning, grid: GridHeadings, turn: FloatArray, apart_m: float
) -> GridCorridors:
    """Straight corridors of a rectilinear building, which constrain positions across the corridor.

    turn: (p,) [rad] from the odometry frame to the map frame at each pass; apart_m: least distance
    between parallel corridors [m].

    A leg that begins and ends along the same axis of the grid led straight on: changing to a
    parallel corridor would have taken that much more driving. A leg whose end is perpendicular to
    its beginning led round one corner, where a junction was missed; chord c and length a + b give
    both parts by a² + b² = c². On such legs heading errors cause no lateral displacement.
    """
    piece = reckoning.piece[grid.row]
    first = np.minimum(np.searchsorted(piece, reckoning.piece[:-1]), len(piece) - 1)
    axis, step = grid.axis[first], np.diff(reckoning.passes.centre, axis=0)
    chord, leg = (
        np.hypot(*step.T),
        np.where(piece[first] == reckoning.piece[:-1], reckoning.leg, np.nan),
    )
    half = np.sqrt(np.maximum(2 * chord**2 - leg**2, 0.0)) / 2
    course = np.arctan2(*step.T[::-1]) + 0.5 * (turn[:-1] + turn[1:]) - axis
    quarter = np.round(course / (np.pi / 2))

    def turned(heading: FloatArray) -> FloatArray:
        """Quarter turns from the course."""
        away = heading - axis - quarter * (np.pi / 2)
        return np.asarray(np.round(wrap(away) / (np.pi / 2)))

    out = turned(reckoning.leaving[:-1] + turn[:-1])
    back = turned(reckoning.arriving[1:] + turn[1:] + np.pi)
    off = course - quarter * (np.pi / 2)
    straight = (out == 0) & (back == 0) & (leg - chord < 0.5 * apart_m)
    straight &= (np.abs(off) < ONE_WAY_RAD) & (chord > LIKELIHOOD.gate_m)
    aside = (out + back) * (0.5 * leg - half)
    # Parts of about equal length are ambiguous. If the odometry contradicts the offset, the robot
    # drove some of the way twice.
    corner = (out * back == 0) & (np.abs(out + back) == 1) & (leg < 4 * half)
    corner &= np.abs(chord * np.sin(off) - aside) < apart_m
    row = np.flatnonzero(straight | corner)
    same = (np.diff(row) == 1) & (np.diff(quarter[row]) % 4 == 0)
    on = same & straight[row[1:]] & straight[row[:-1]]
    begin = np.flatnonzero(np.concatenate([[True], ~on])[: len(row)])
    size = np.diff(begin, append=len(row)) + 1
    corridor, along = numbered(size)
    passed = row[begin][corridor] + along
    return GridCorridors(
        direction=(axis + quarter * (np.pi / 2))[row[begin]],
        spread_rad=np.full(len(begin), grid.spread_rad),
        side=quarter[row[begin]].astype(np.int64) % 2,
        corridor=corridor,
        row=passed,
        aside=np.where((along > 0) & corner[passed - 1], aside[passed - 1], 0.0),
        sigma_m=float(
            np.hypot(reckoning.noise.centre_m, LIKELIHOOD.gate_m / LIKELIHOOD.gate_sigmas)
        ),
    )


def with_spread(
    grid: GridHeadings, passes: Passes, branch_rad: float, spread_rad: float
) -> GridHeadings:
    """The headings with other noise: of reading a branch, and of corridors' deviations from the
    grid [rad]."""
    sigma = np.sqrt(branch_rad**2 / passes.branches.counts[grid.row] + spread_rad**2)
    return replace(grid, sigma=sigma, spread_rad=spread_rad)


def from_quarter(angle: FloatArray) -> FloatArray:
    """Signed distance of angles [rad] from the nearest multiple of a quarter turn, in [-pi/4,
    pi/4)."""
    out: FloatArray = (angle + np.pi / 4) % (np.pi / 2) - np.pi / 4
    return out
