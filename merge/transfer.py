"""Transfer of named points from one map to another through the junctions that both have.

Maps bend, each in its own way, so that one rigid transform for all of a map is not accurate enough.
A point is transformed rigidly through every matched junction near it, and the results are combined
by generalised least squares (universal kriging: Matheron, 1971; Cressie, *Statistics for Spatial
Data*, 1993, 3.4). The bending between two maps is modelled as an intrinsic random process whose
variogram grows linearly with distance; its slope is estimated by predicting each matched junction
from the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

from ..topology.arrays import FloatArray, IntArray
from ..topology.frozen import freeze
from ..topology.matching.structure import padded_branches
from ..topology.se2 import turned, wrap
from ..topology.topomap import TopoMap
from .fusion.joint_graph import JOINT, measured_turn
from .result import MergeResult

WITHIN_SIGMAS = float(np.sqrt(-2 * np.log(0.05)))
"""95 % quantile of the error of a point in the plane, in sigmas of a coordinate (Rayleigh
distribution)."""


@dataclass(frozen=True, slots=True)
class TransferSettings:
    """Settings of the interpolation."""

    neighbours: int = 4
    """Nearest matched junctions that a point is transferred through. More do not help, and bring in
    bending from farther away: of 3, 4, 6, 8, 16 and 32 the errors keep best to their sigmas with 4
    (`benchmarks/transfer.py`)."""
    prior_log_sigma: float = 1.1
    """1 sigma of the natural logarithm of the bending that the noise of both maps suggests, a
    factor of 3; a very strong and a very weak prior are worse by the same."""


TRANSFER = TransferSettings()


@dataclass(frozen=True, slots=True, eq=False)
class MatchedJunctions:
    """The junctions that two maps have in common.

    source, target: (k, 2) positions in either map [m]; sigma: (k,) 1 sigma per axis of their
    difference by detection alone [m]; turn: (k,) rotation of the source map's frame to the target
    map's there, by their branches [rad]; turn_sigma: (k,) [rad], inf without branches in common.
    bending: variance per metre [m²/m], and turning: variance of the rotation per metre [rad²/m], as
    suggested by the noise of the two maps. Raises ValueError on shapes that do not fit.
    """

    source: FloatArray
    target: FloatArray
    sigma: FloatArray
    turn: FloatArray
    turn_sigma: FloatArray
    bending: float
    turning: float

    def __post_init__(self) -> None:
        k = len(self.source)
        freeze(self, np.float64, source=(k, 2), target=(k, 2), sigma=(k,))
        if len(self.turn) != k or len(self.turn_sigma) != k:
            raise ValueError("one turn for every junction is needed")

    def __len__(self) -> int:
        return len(self.source)


@dataclass(frozen=True, slots=True, eq=False)
class Transferred:
    """Transferred points.

    xy: (p, 2) [m]; turn: (p,) to be added to headings there [rad]; sigma_m: (p,) 1 sigma of each
    coordinate; sigma_rad: (p,); nearest_m: (p,) distance of the nearest matched junction.
    """

    xy: FloatArray
    turn: FloatArray
    sigma_m: FloatArray
    sigma_rad: FloatArray
    nearest_m: FloatArray


def junctions_of_runs(
    result: MergeResult, maps: Mapping[str, TopoMap], source: str, target: str
) -> MatchedJunctions:
    """The junctions that a merge identified in two runs, directly or through others.

    maps: at least those of the two runs, as they were merged (`stale_runs`).
    """
    fused = result.fused
    pairs = [
        (members[source][0], members[target][0])
        for members, turned in zip(fused.members, fused.is_turned, strict=True)
        if not turned and members.get(source) and members.get(target)
    ]
    poses = result.component_of[source].poses
    turn = float(poses[source][2] - poses[target][2])
    return _matched(maps[source], maps[target], pairs, turn)


def junctions_of_merged(result: MergeResult, source: TopoMap, merged: TopoMap) -> MatchedJunctions:
    """The junctions of a run in the fused map of its component (`component_map`)."""
    nodes = merged.info["members"]["nodes"][: len(merged)]
    pairs = [(vertex, k) for k, own in enumerate(nodes) for vertex in own.get(source.run, ())]
    pose = result.component_of[source.run].poses[source.run]
    return _matched(source, merged, pairs, float(pose[2]))


def _matched(
    a: TopoMap, b: TopoMap, pairs: Sequence[tuple[int, int]], turn_rad: float
) -> MatchedJunctions:
    """Junctions of a and of b that are one place, with the rotation that their branches show.

    pairs: their vertices; turn_rad: about the rotation from a's frame to b's. Sigmas have the lower
    bounds of the joint pose graph."""
    u, v = np.array(pairs, np.int64).reshape(-1, 2).T
    share = np.stack([1 / np.maximum(m.passes[rows], 1) for m, rows in ((a, u), (b, v))])
    noise = a.measured, b.measured
    both = np.array([n.centre_m**2 for n in noise]) @ share
    heading_b, heading_a = padded_branches(b)[v], padded_branches(a)[u]
    expected = np.full(len(pairs), float(wrap(turn_rad)))
    turn, count = measured_turn(heading_b, heading_a, expected)
    spread = np.array([n.branch_rad**2 for n in noise]) @ share / np.maximum(count, 1)
    turning = sum(n.heading_rad_per_sqrt_m**2 for n in noise)
    length = float(np.median(np.concatenate([a.length, b.length, [1.0]])))
    # Errors of a corridor: along by its own random walk, across by that of its heading, σ² L² / 3.
    bending = sum(n.along_m_per_sqrt_m**2 for n in noise) + turning * length**2 / 3
    return MatchedJunctions(
        source=a.xy[u],
        target=b.xy[v],
        sigma=np.sqrt(both + JOINT.min_position_m**2),
        turn=turn,
        turn_sigma=np.where(count > 0, np.sqrt(spread + JOINT.min_heading_rad**2), np.inf),
        bending=bending,
        turning=turning,
    )


def transfer(points: FloatArray, matched: MatchedJunctions) -> Transferred:
    """Transfer points (p, 2) [m] of the source map to the target map.

    Raises ValueError without matched junctions. O(p n³) for n neighbours; five kilobytes a point.
    """
    if len(matched) == 0:
        raise ValueError("the two maps have no junction in common")
    points = np.asarray(points, np.float64).reshape(-1, 2)
    bending = _bending(matched)
    count = min(TRANSFER.neighbours, len(matched))
    tree = cKDTree(matched.source)
    distance, rows = tree.query(points, k=count)
    rows = np.asarray(rows, np.int64).reshape(len(points), count)
    nearest = np.asarray(distance).reshape(len(points), count)[:, 0]
    xy, variance, turn, turn_variance = _carried(points, matched, rows, bending)
    return Transferred(xy, turn, np.sqrt(variance), np.sqrt(turn_variance), nearest)


def _carried(
    points: FloatArray, matched: MatchedJunctions, rows: IntArray, bending: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points (p, 2) transferred through their junctions, rows: (p, n): positions, mean variance of
    the two coordinates, rotation and its variance.

    All points at once: (p, 2 n, 2 n) covariances of the single transfers, one solve.
    """
    arm = matched.source[rows] - points[:, None]
    away = np.hypot(arm[..., 0], arm[..., 1])
    weight = 1 / (matched.turn_sigma[rows] ** 2 + matched.turning * away)
    # Where no branch measures the turn, its sigma is π.
    total = np.maximum(weight.sum(axis=1), 1 / np.pi**2)
    first = matched.turn[rows[:, :1]]
    turn = first[:, 0] + (weight * wrap(matched.turn[rows] - first)).sum(axis=1) / total
    arm = turned(arm, turn[:, None])
    predicted = matched.target[rows] - arm
    between = matched.source[rows][:, :, None] - matched.source[rows][:, None]
    apart = np.hypot(between[..., 0], between[..., 1])
    # Covariance of a random walk that starts at the point: two junctions share part of the way.
    walk = 0.5 * bending * (away[:, :, None] + away[:, None] - apart)
    own = matched.sigma[rows] ** 2
    n = rows.shape[1]
    walk = walk + own[:, :, None] * np.eye(n)
    # An error of the rotation moves all results across their arms, by one angle.
    across = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    covariance = np.einsum("pij,ab->piajb", walk, np.eye(2))
    covariance = covariance + np.einsum("pia,pjb,p->piajb", across, across, 1 / total)
    flat = covariance.reshape(len(points), 2 * n, 2 * n)
    design = np.broadcast_to(np.tile(np.eye(2), (n, 1)), (len(points), 2 * n, 2))
    weighted = np.linalg.solve(flat, design)
    normal = np.einsum("pka,pkb->pab", design, weighted)
    right = np.einsum("pka,pk->pa", weighted, predicted.reshape(len(points), 2 * n))
    inverse = np.linalg.inv(normal)
    xy = np.einsum("pab,pb->pa", inverse, right)
    variance = np.trace(inverse, axis1=1, axis2=2) / 2
    return xy, variance, np.asarray(wrap(turn)), 1 / total


def _bending(matched: MatchedJunctions) -> float:
    """Variance per metre by which two maps bend apart: the maximum a posteriori, with the
    likelihood of predicting each matched junction from the others and a log-normal prior about what
    the noise of the maps suggests."""
    k = len(matched)
    if k < 3:
        return matched.bending
    count = min(TRANSFER.neighbours, k - 1)
    _, rows = cKDTree(matched.source).query(matched.source, k=count + 1)
    rows = np.asarray(rows, np.int64)
    own = rows == np.arange(k)[:, None]
    own[~own.any(axis=1), -1] = True  # junctions in one spot: leave the farthest out instead
    others = rows[~own].reshape(k, count)

    def cost(log_ratio: float) -> float:
        """Minus the log posterior of the bending, over what the noise suggests."""
        bending = float(matched.bending * np.exp(log_ratio))
        xy, variance, *_ = _carried(matched.source, matched, others, bending)
        spread = variance + matched.sigma**2
        off = ((xy - matched.target) ** 2).sum(axis=1)
        # Junctions predict one another and are not independent: half the log likelihood.
        fit = float((off / (2 * spread) + np.log(spread)).sum()) / 2
        return fit + (log_ratio / TRANSFER.prior_log_sigma) ** 2 / 2

    return float(matched.bending * np.exp(minimize_scalar(cost).x))
