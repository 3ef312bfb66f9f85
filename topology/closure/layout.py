"""Where the passes and places of a walk lie, given which passes were by the same place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..circular import AngleClusters, cluster_angles
from ..posegraph import PoseGraph, SolverSettings, solve
from ..se2 import wrap
from .walk import Walk, relative_covariance

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SLOT_GAP_RAD = 0.35
"""Branch readings of several passes farther apart than this belong to different branches."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """pose: (p, 3) of every pass in the map frame: its centre, and the turn from odometry to map.

    xy: (n, 2) position of every place.
    """

    pose: FloatArray
    xy: FloatArray


def slots_of(walk: Walk, place: IntArray, turn: FloatArray) -> AngleClusters:
    """Branches of the places: readings of all passes, turned into the map frame, clustered.

    place: (p,), passes with place < 0 are left out (their readings form circles of their own);
    turn: (p,) from the odometry's frame to the map's at each pass [rad].
    """
    owner = walk.passes.branches.owner
    home = np.where(place < 0, place.max(initial=0) + 1 + np.arange(len(walk)), place)
    return cluster_angles(walk.passes.branches.values + turn[owner], home[owner], SLOT_GAP_RAD)


def lay_out(walk: Walk, place: IntArray, start: FloatArray | None = None) -> Layout:
    """Most likely poses of passes and places, from odometry and identifications.

    place: (p,) place of each pass, numbered from 0; negative: none. start: (p, 3) poses to begin
    with. Nodes of the pose graph are the passes (at their centre, turned like the odometry's
    frame) and the places of several passes; legs join passes, sightings join passes to places.
    """
    count = len(walk)
    if start is None:
        start = np.column_stack([walk.passes.centre, np.zeros(count)])
    places = int(place.max(initial=-1)) + 1
    visits = np.bincount(place[place >= 0], minlength=places)
    several = np.flatnonzero(visits > 1)
    node = np.full(places, -1, np.int64)
    node[several] = count + np.arange(len(several))
    legs, shared = _legs(walk), _sightings(walk, place, visits, start)
    guess = np.zeros((len(several), 3))
    for k in (0, 1):
        total = np.bincount(place[shared.row], start[shared.row, k], minlength=places)
        guess[:, k] = total[several] / visits[several]
    graph = PoseGraph(
        pose=np.vstack([start, guess]),
        source=np.concatenate([legs.row, shared.row]),
        target=np.concatenate([legs.row + 1, node[place[shared.row]]]),
        measurement=np.vstack([legs.measurement, shared.measurement]),
        information=np.concatenate([legs.information, shared.information]),
    )
    pose = solve(graph, SolverSettings(start="given")).pose
    xy = np.zeros((places, 2))
    alone = np.flatnonzero((place >= 0) & (visits[np.maximum(place, 0)] == 1))
    xy[place[alone]] = pose[alone, :2]
    xy[several] = pose[count:, :2]
    return Layout(pose[:count], xy)


@dataclass(frozen=True, slots=True, eq=False)
class _Factors:
    """row: (k,) pass that each factor begins at."""

    row: IntArray
    measurement: FloatArray
    information: FloatArray


def _legs(walk: Walk) -> _Factors:
    row = np.flatnonzero(np.isfinite(walk.leg))
    cov = relative_covariance(walk, row, row + 1) + np.diag([1e-6, 1e-6, 1e-8])
    shift = np.diff(walk.passes.centre, axis=0)[row]
    information: FloatArray = np.linalg.inv(cov).astype(np.float64)
    return _Factors(row, np.column_stack([shift, np.zeros(len(row))]), information)


def _sightings(walk: Walk, place: IntArray, visits: IntArray, pose: FloatArray) -> _Factors:
    """Passes of places with several: the centre coincides, the branches fix the direction."""
    row = np.flatnonzero((place >= 0) & (visits[np.maximum(place, 0)] > 1))
    branches = walk.passes.branches
    slots = slots_of(walk, place, pose[:, 2])
    # How each pass would have to be turned for its branches to meet the places' mean branches.
    off = wrap(slots.mean[slots.of] - branches.values - pose[branches.owner, 2])
    counts = np.maximum(branches.counts, 1)
    turn = pose[:, 2] + np.bincount(branches.owner, off, minlength=len(walk)) / counts
    measurement = np.column_stack([np.zeros((len(row), 2)), wrap(-turn[row])])
    information = np.zeros((len(row), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = walk.noise.centre_m**-2
    information[:, 2, 2] = counts[row] * walk.noise.branch_rad**-2
    return _Factors(row, measurement, information)
