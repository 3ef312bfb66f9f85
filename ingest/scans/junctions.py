"""Junction passes: fusion of the forks in all windows along the track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import FloatArray, IntArray
from ...topology.connected import connected
from ...topology.digits import significant
from ...topology.passes import ONE_WAY_RAD
from ...topology.ragged import Ragged
from ...topology.run import ScanPasses
from ...topology.se2 import apply, inverse, wrap
from .windows import WINDOWS, Seen


@dataclass(frozen=True, slots=True)
class JunctionSettings:
    """When forks in windows are one junction."""

    together_m: float = 0.7
    """Forks of different windows and variants within this distance are one junction."""
    together_way_m: float = 2.5
    """Only within this distance driven: else the robot was there twice."""
    least_share: float = 0.5
    """Least share of the windows that could show a junction that must show it."""


JUNCTIONS = JunctionSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """The track: (k,) times, (k, 3) poses in the corrected frame, (k,) distance driven [m]."""

    time_ns: IntArray
    pose: FloatArray
    way: FloatArray


class _Junction(NamedTuple):
    """A junction fused from the windows around it: rows: of the track where it is nearest, first
    and last near; way: distance driven at it [m]; xy [m]; branches: headings; windows: number that
    show it; confidence, clearance_m, sigma_m: see `ScanPasses`."""

    rows: tuple[int, int, int]
    way: float
    xy: FloatArray
    branches: FloatArray
    confidence: float
    windows: int
    clearance_m: float
    sigma_m: float


def junction_passes(seen: Sequence[Seen], driven: Driven) -> ScanPasses:
    """Fuse the forks of all windows and variants to passes. O(q log q) for q forks."""
    nodes = [node for window in seen for _, _, node in window.forks]
    if not nodes:
        return no_passes()
    number = np.array([window.number for window in seen for _ in window.forks])
    variant = np.array([variant for window in seen for variant, _, _ in window.forks])
    way = np.array([way for window in seen for _, way, _ in window.forks])
    xy = np.array([node.xy for node in nodes])
    clearance = np.array([node.clearance_m for node in nodes])
    sigma = np.array([node.sigma_m for node in nodes])
    headings = Ragged.from_rows([node.headings for node in nodes])
    bends = np.concatenate([node.bends for node in nodes])
    group = _together(xy, way)
    middles = np.array([window.way for window in seen])
    found, turns = [], []
    for g in range(int(group.max()) + 1):
        members = np.flatnonzero(group == g)
        at = float(np.median(way[members]))
        near = np.flatnonzero(np.abs(middles - at) <= 1.5 * WINDOWS.every_m)
        looks = len(WINDOWS.variants) * max(len(near), 1)
        # Count each window and variant once, even if it shows the place as two halves.
        shown = len(np.unique(number[members] * len(WINDOWS.variants) + variant[members]))
        if shown < JUNCTIONS.least_share * looks:
            continue
        votes = _nearest_looks(members, variant, np.abs(middles[number] - at))
        degree = np.bincount(headings.counts[votes])
        branches, turn = _branches((headings, bends), members, votes, int(np.argmax(degree)))
        turns.append(turn)
        place = np.median(xy[members], axis=0)
        found.append(
            _Junction(
                rows=_rows_by(driven, at, place),
                way=at,
                xy=place,
                branches=branches,
                confidence=int(degree.max()) / len(WINDOWS.variants),
                windows=len(np.unique(number[members])),
                clearance_m=float(np.median(clearance[members])),
                sigma_m=float(np.median(sigma[members])),
            )
        )
    found.sort(key=lambda junction: (junction.rows[0], junction.way, *junction.xy))
    usual = WINDOWS.variants[0]
    askew_rad = _askew(turns, usual.grid.cell_m / usual.skeleton.chord_m)
    return replace(_passes(found, driven), askew_rad=askew_rad)


QUARTILE = 0.3186
"""Quantile of the absolute value of a standard normal at 25 %."""


def _askew(turns: list[FloatArray], cell: float) -> float:
    """1 sigma [rad] of the heading error that all passes by a junction share.

    turns: per junction, by how much the chords of length r and 2 r of its branches differ [rad],
    NaN if unknown; cell: size of a cell, divided by r. A centre displaced by d turns the two chords
    by d / r and half of that: the error is twice their difference. A bend of the branch causes an
    error of about their difference. Twice the difference covers both. Its scale is taken from the
    first quartile, as half of the corridors between racks have a corner within 2 r. The variance of
    rounding to cells is subtracted, because it differs from pass to pass (`branch_rad`).
    """
    every = np.concatenate([np.zeros(0), *turns])
    bends = np.abs(every[np.isfinite(every)])
    differ = (float(np.quantile(bends, 0.25)) / QUARTILE) ** 2 if len(bends) else 0.0
    return significant(2 * float(np.sqrt(max(differ - 1.25 * cell**2 / 12, 0.0))))


def no_passes() -> ScanPasses:
    """The passes of a run without junctions."""
    none, empty = np.zeros(0, np.int64), Ragged.from_rows([])
    row = np.zeros(0)
    return ScanPasses(none, none, none, np.zeros((0, 2)), empty, row, none, row, row)


def pass_midway(driven: Driven) -> ScanPasses:
    """A pass by the middle of the way, with branches ahead and back: for a run that shows no
    junction, in one corridor, hall or room, so that it has a map, which its views can place."""
    way = driven.way
    middle = driven.time_ns[[int(np.searchsorted(way, way[-1] / 2))]]
    one = np.ones(1)
    return ScanPasses(
        time_ns=middle,
        start_ns=middle,
        end_ns=middle,
        centre=np.zeros((1, 2)),
        branches=Ragged.from_rows([np.array([-np.pi, 0.0])]),
        confidence=one,
        windows=np.ones(1, np.int64),
        clearance_m=one,
        shared_m=np.zeros(1),
        resolution_m=WINDOWS.skeleton.join_m,
    )


def _together(xy: FloatArray, way: FloatArray) -> IntArray:
    """(q,) junction of each fork: connected if near in place and in distance driven."""
    scaled = np.column_stack([xy, way * (JUNCTIONS.together_m / JUNCTIONS.together_way_m)])
    pairs = cKDTree(scaled).query_pairs(JUNCTIONS.together_m, output_type="ndarray")
    return connected(pairs[:, 0], pairs[:, 1], len(xy))


def _nearest_looks(members: IntArray, variant: IntArray, away: FloatArray) -> IntArray:
    """The forks of one junction in each variant's nearest window, which sees most of the
    surroundings."""
    order = members[np.lexsort((members, away[members], variant[members]))]
    return order[np.unique(variant[order], return_index=True)[1]]


def _branches(
    looks: tuple[Ragged, FloatArray], members: IntArray, votes: IntArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Headings of a junction with `degree` branches [rad], and the change of each further on [rad]
    (NaN: unknown).

    looks: headings and bends of all forks; members: ascending. The medoid of the votes with this
    degree, refined by the mean over all forks' branches near it.
    """
    headings, bends = looks
    alike = headings.take(votes[headings.counts[votes] == degree])
    table = alike.values.reshape(-1, degree)
    off = np.abs(wrap(table[:, None, :, None] - table[None, :, None, :])).min(axis=3)
    medoid = table[int(np.argmin(off.sum(axis=(1, 2))))]
    own = headings.take(members)
    away = np.asarray(wrap(own.values[:, None] - medoid))
    nearest = np.argmin(np.abs(away), axis=1)
    gap = away[np.arange(len(away)), nearest]
    near = np.abs(gap) <= ONE_WAY_RAD
    count = np.bincount(nearest[near], minlength=degree)
    mean = np.bincount(nearest[near], gap[near], degree) / np.maximum(count, 1)
    turn = bends[np.isin(headings.owner, members)]
    turned = near & np.isfinite(turn)
    tells = np.bincount(nearest[turned], minlength=degree)
    with np.errstate(invalid="ignore"):
        turn = np.bincount(nearest[turned], turn[turned], degree) / tells
    return np.asarray(wrap(medoid + mean)), turn


def _rows_by(driven: Driven, way: float, xy: FloatArray) -> tuple[int, int, int]:
    """Rows of the track where the robot is nearest to a junction, and the first and last one near
    it."""
    a, b = np.searchsorted(driven.way, way + 2 * WINDOWS.near_m * np.array([-1.0, 1.0])).tolist()
    b, a = max(b, a + 1), min(a, len(driven.way) - 1)
    distance = np.hypot(*(driven.pose[a:b, :2] - xy).T)
    near = np.flatnonzero(distance <= max(WINDOWS.near_m, float(distance.min())))
    return a + int(np.argmin(distance)), a + int(near[0]), a + int(near[-1])


def _passes(found: list[_Junction], driven: Driven) -> ScanPasses:
    """Junctions in the corrected frame, transformed to the robot's frame at the nearest time."""
    if not found:
        return no_passes()
    nearest, start, end = np.array([junction.rows for junction in found]).T
    pose = driven.pose[nearest]
    branches = Ragged.from_rows([junction.branches for junction in found])
    return ScanPasses(
        time_ns=driven.time_ns[nearest],
        start_ns=driven.time_ns[start],
        end_ns=driven.time_ns[end],
        centre=apply(inverse(pose), [junction.xy for junction in found]),
        branches=Ragged(branches.offsets, wrap(branches.values - pose[branches.owner, 2])),
        confidence=np.array([junction.confidence for junction in found]),
        windows=np.array([junction.windows for junction in found], np.int64),
        clearance_m=np.array([junction.clearance_m for junction in found]),
        shared_m=np.array([junction.sigma_m for junction in found]),
        resolution_m=WINDOWS.skeleton.join_m,
    )
