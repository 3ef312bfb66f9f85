"""Manhattan worlds: buildings whose corridors meet at right angles (the paper's rectilinear
worlds).

The branches of a single pass give the robot's heading up to quarter turns, and the odometry gives
the quarter, so that heading errors do not accumulate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..matching.likelihood import LIKELIHOOD
from ..passes import ONE_WAY_RAD, Passes
from ..ragged import numbered
from ..se2 import wrap
from .dead_reckoning import DeadReckoning, relative_covariance


@dataclass(frozen=True, slots=True)
class RectilinearSettings:
    """When a building counts as rectilinear."""

    least_share: float = 0.9
    """Least share of the angles between branches of a pass that are near quarter turns (rule of
    succession, so that at least eight angles are needed). Of uniform angles a third are near."""
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
    """Passes whose branches give the rotation from the odometry frame to the map frame.

    The map frame is the odometry frame at the first of these passes in each piece of the odometry.
    row: (k,) pass; turn: (k,) [rad], continuous along a piece; axis: (k,) direction
    of the grid in the map frame [rad]; sigma: (k,) 1 sigma of turn [rad], including `spread_rad`,
    the deviation of single corridors from the grid.
    """

    row: IntArray
    turn: FloatArray
    axis: FloatArray
    sigma: FloatArray
    spread_rad: float


def grid_headings(reckoning: DeadReckoning) -> GridHeadings | None:
    """Rotation from odometry to map frame at each pass that sees the building's grid; None if the
    building is not rectilinear (`RectilinearSettings`)."""
    branches = reckoning.passes.branches
    owner = branches.owner
    # Angles between neighbouring branches of a pass, as distance from the next quarter turn.
    same_pass = owner[1:] == owner[:-1]
    deviation = from_quarter(np.diff(branches.values)[same_pass])
    # The tolerance includes the sensor's noise.
    variance = reckoning.noise.branch_rad**2 + RECTILINEAR.spread_rad**2
    tolerance = LIKELIHOOD.gate_sigmas * np.sqrt(2.0 * variance)
    near_count = np.count_nonzero(np.abs(deviation) < tolerance)
    if tolerance > 0.5 or (near_count + 1) / (len(deviation) + 2) < RECTILINEAR.least_share:
        return None
    # Direction of the grid as each pass sees it: mean on the circle of quarter turns.
    count = len(reckoning)
    direction = np.bincount(owner, np.cos(4 * branches.values), count) + 1j * np.bincount(
        owner, np.sin(4 * branches.values), count
    )
    count_of_pass = branches.counts
    row = np.flatnonzero(np.abs(direction) > 0.5 * count_of_pass)
    if len(row) < 2:
        return None
    grid = np.angle(direction[row]) / 4
    # In the odometry frame the grid turns by the drift, which is small from pass to pass.
    step = from_quarter(np.diff(grid))
    sigma = np.sqrt(reckoning.noise.branch_rad**2 / count_of_pass[row] + RECTILINEAR.spread_rad**2)
    drift = relative_covariance(reckoning, row[:-1], row[1:])[:, 2, 2]
    chi2 = step**2 / (drift + sigma[1:] ** 2 + sigma[:-1] ** 2)
    connected = reckoning.piece[row[:-1]] == reckoning.piece[row[1:]]
    if connected.any() and chi2[connected].mean() > RECTILINEAR.most_wander:
        return None
    # Each piece of the odometry has a frame of its own.
    turn = -np.concatenate([[0.0], np.cumsum(step)])
    first_of_piece = np.flatnonzero(np.concatenate([[True], ~connected]))
    size = np.diff(first_of_piece, append=len(row))
    turn = np.asarray(wrap(turn - np.repeat(turn[first_of_piece], size)))
    axis = np.repeat(grid[first_of_piece], size)
    return GridHeadings(row, turn, axis, sigma, RECTILINEAR.spread_rad)


@dataclass(frozen=True, slots=True, eq=False)
class GridCorridors:
    """Straight corridors along the grid of a building, one per drive through a corridor.

    direction: (c,) [rad] in the map frame, with the spread of the grid; corridor, row: (k,) every
    pass on a corridor, with the corridor, sorted by both; aside: (k,) lateral offset of the pass
    from the corridor's line [m], positive to the left, with 1 sigma sigma_m.
    """

    direction: FloatArray
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

    A leg that begins and ends along the same axis of the grid is straight, if it is too short for a
    change to a parallel corridor. A leg whose end is perpendicular to its beginning leads round one
    corner, where a junction was missed; chord c and length a + b give both parts by a² + b² = c².
    On such legs heading errors cause no lateral displacement.
    """
    piece = reckoning.piece[grid.row]
    first = np.minimum(np.searchsorted(piece, reckoning.piece[:-1]), len(piece) - 1)
    axis, step = grid.axis[first], np.diff(reckoning.passes.centre, axis=0)
    chord, leg = (
        np.hypot(*step.T),
        np.where(piece[first] == reckoning.piece[:-1], reckoning.leg, np.nan),
    )
    half_leg = np.sqrt(np.maximum(2 * chord**2 - leg**2, 0.0)) / 2
    course = np.arctan2(*step.T[::-1]) + 0.5 * (turn[:-1] + turn[1:]) - axis
    quarter = np.round(course / (np.pi / 2))

    def turned(heading: FloatArray) -> FloatArray:
        """Number of quarter turns of headings from the course."""
        away = heading - axis - quarter * (np.pi / 2)
        return np.asarray(np.round(wrap(away) / (np.pi / 2)))

    leaves = turned(reckoning.leaving[:-1] + turn[:-1])
    arrives = turned(reckoning.arriving[1:] + turn[1:] + np.pi)
    deviation = course - quarter * (np.pi / 2)
    straight = (leaves == 0) & (arrives == 0) & (leg - chord < 0.5 * apart_m)
    straight &= (np.abs(deviation) < ONE_WAY_RAD) & (chord > LIKELIHOOD.gate_m)
    aside = (leaves + arrives) * (0.5 * leg - half_leg)
    # Parts of nearly equal length are ambiguous. If the odometry contradicts the offset, the robot
    # drove part of the way twice.
    corner = (leaves * arrives == 0) & (np.abs(leaves + arrives) == 1) & (leg < 4 * half_leg)
    corner &= np.abs(chord * np.sin(deviation) - aside) < apart_m
    rows = np.flatnonzero(straight | corner)
    continues = (np.diff(rows) == 1) & (np.diff(quarter[rows]) % 4 == 0)
    on_line = continues & straight[rows[1:]] & straight[rows[:-1]]
    begins = np.flatnonzero(np.concatenate([[True], ~on_line])[: len(rows)])
    size = np.diff(begins, append=len(rows)) + 1
    corridor, nth = numbered(size)
    passes = rows[begins][corridor] + nth
    return GridCorridors(
        direction=(axis + quarter * (np.pi / 2))[rows[begins]],
        corridor=corridor,
        row=passes,
        aside=np.where((nth > 0) & corner[passes - 1], aside[passes - 1], 0.0),
        sigma_m=float(
            np.hypot(reckoning.noise.centre_m, LIKELIHOOD.gate_m / LIKELIHOOD.gate_sigmas)
        ),
    )


def with_spread(
    grid: GridHeadings, passes: Passes, branch_rad: float, spread_rad: float
) -> GridHeadings:
    """The headings with other noise [rad]: of branches, and of corridors about the grid."""
    sigma = np.sqrt(branch_rad**2 / passes.branches.counts[grid.row] + spread_rad**2)
    return replace(grid, sigma=sigma, spread_rad=spread_rad)


def from_quarter(angle: FloatArray) -> FloatArray:
    """Signed distance of angles [rad] from the nearest multiple of a quarter turn, in [-pi/4,
    pi/4)."""
    return np.asarray((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4)
