"""Consensus trajectories of all scans of a log, where published corrected poses are too coarse as
truth.

Corrected paths of published logs are a filter's poses of about every tenth scan, with heading
errors of degrees. Scans of one place at different times locate the robot better. All are aligned at
once (point to line, least squares over the whole log), with pairs found by the corrected path, and
with the odometry. Odometry and maps that do not use revisits can be compared with the result; its
own accuracy is estimated by how far it moves when the odometry's weight is a tenth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from numpy.typing import NDArray

from topobatch.ingest.scans.alignment import ALIGNMENT, Steps, match_steps
from topobatch.ingest.scans.association import Gate, Swept, pair_terms
from topobatch.ingest.scans.keyframes import Keyframes, join
from topobatch.ingest.scans.matching import matched, posed
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.ingest.scans.step_errors import StepErrors
from topobatch.topology.columns import take
from topobatch.topology.odometry import Odometry
from topobatch.topology.se2 import between, compose, fit_rigid, inverse, turned_axes, wrap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NEAR_M, AWAY_M, AROUND_M, EACH = 6.0, 14.0, 4.0, 8
"""Poses so near by the corrected path may see the same, after so much way; way around a pose by
which its place in that path is told; pairs of a scan that are tried."""
OFFSETS = (1, 2, 4, 8, 14, 20, 28, 36, 46, 56)
ROUNDS = ((3, Gate(0.5, 0.15)), (3, Gate(0.3, 0.08)), (4, Gate(0.2, 0.05)))
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
LIKE_M, LIKE_RAD, LIKE_FIT = 0.8, 0.15, 0.5
"""How far from the corrected path, and how well, a pair has to fit to be believed."""


@dataclass(frozen=True)
class Revisits:
    """path: the robot's poses as all scans have it, and `loose` as they do with hardly any
    odometry; pairs: of revisits; fit, fit_truth: mean share of their points on surfaces."""

    path: Odometry
    loose: Odometry
    pairs: int
    fit: float
    fit_truth: float


def revisits(odometry: Odometry, batches: list[ScanBatch], truth: Odometry) -> Revisits:
    """The path of keyframes between the truth's first pose and its last; one laser."""
    parts = list(matched(posed(odometry, batches)))
    frames = join([part.keyframes for part in parts])
    inside = np.flatnonzero(
        (frames.time_ns >= truth.time_ns[0]) & (frames.time_ns <= truth.time_ns[-1])
    )
    frames = take(frames, inside)
    ours = frames.pose
    scans = Swept.of(frames)
    real = compose(truth.at(frames.time_ns), frames.mount)
    start, again = _started(real, ours), _again(real, ours)
    found = match_steps(scans, again, _loose(between(start[again[1]], start[again[0]])), 0.0)
    off = between(between(start[again[1]], start[again[0]]), found.motion)
    like = (found.fit > LIKE_FIT) & (np.hypot(off[:, 0], off[:, 1]) < LIKE_M)
    like &= np.abs(off[:, 2]) < LIKE_RAD
    again = again[0][like], again[1][like]
    n = len(frames)
    near = [(np.arange(k, n), np.arange(n - k)) for k in OFFSETS]
    pairs = (
        np.concatenate([*(a for a, _ in near), again[0]]),
        np.concatenate([*(b for _, b in near), again[1]]),
    )
    steps = _steps(frames, parts[-1].errors)
    pose, weak = start, Steps(steps.motion, 0.1 * steps.information)
    for rounds, gate in ROUNDS:
        for _ in range(rounds):
            pose = _solved(scans, pose, pairs, steps, gate)
    loose = pose
    for _ in range(ROUNDS[-1][0]):
        loose = _solved(scans, loose, pairs, weak, ROUNDS[-1][1])
    poses = [pose, loose]
    fits = [
        float(
            pair_terms(scans, *again, between(p[again[1]], p[again[0]]), ROUNDS[-1][1]).fit.mean()
        )
        for p in (poses[0], real)
    ]
    paths = [
        Odometry(frames.time_ns, compose(p, inverse(frames.mount)), np.zeros(0, np.int64))
        for p in poses
    ]
    return Revisits(paths[0], paths[1], len(again[0]), *fits)


def _loose(motion: FloatArray) -> Steps:
    return Steps(motion, np.tile(np.diag([0.1, 0.1, 1.0]), (len(motion), 1, 1)))


def _steps(frames: Keyframes, errors: StepErrors) -> Steps:
    n = len(frames)
    return errors.steps(frames, np.arange(1, n), np.arange(n - 1))


def _started(real: FloatArray, ours: FloatArray) -> FloatArray:
    """Our poses, each where the way around it lies in the corrected path."""
    way = _way(ours)
    out = np.empty_like(ours)
    for k in range(len(ours)):
        a, b = np.searchsorted(way, [way[k] - AROUND_M, way[k] + AROUND_M])
        out[k] = compose(fit_rigid(real[a:b, :2], ours[a:b, :2]), ours[k])
    return out


def _again(real: FloatArray, ours: FloatArray) -> tuple[IntArray, IntArray]:
    """Pairs near each other and long apart, of each scan `EACH` evenly among all."""
    way = _way(ours)
    first, second = [], []
    for k in range(len(ours)):
        before = int(np.searchsorted(way, way[k] - AWAY_M))
        near = np.flatnonzero(np.hypot(*(real[:before, :2] - real[k, :2]).T) < NEAR_M)
        some = near[np.linspace(0, len(near) - 1, min(EACH, len(near))).astype(np.int64)]
        first.append(np.full(len(some), k))
        second.append(some)
    return np.concatenate(first), np.concatenate(second)


def _way(pose: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))])


def _solved(
    scans: Swept, pose: FloatArray, pairs: tuple[IntArray, IntArray], steps: Steps, gate: Gate
) -> FloatArray:
    """One round of Gauss-Newton over all poses, the first of which stays."""
    first, second = pairs
    n = len(pose)
    terms = pair_terms(scans, first, second, between(pose[second], pose[first]), gate)
    scale = ALIGNMENT.joint_worth * terms.weight.sum() / terms.moments[:, 3, 3].sum()
    off = between(pose[:-1], pose[1:]) - steps.motion
    off[:, 2] = wrap(off[:, 2])
    distance = np.einsum("pk,pkl,pl->p", off, steps.information, off)
    information = steps.information / (1 + distance / 9)[:, None, None]
    first, second = np.append(first, np.arange(1, n)), np.append(second, np.arange(n - 1))
    inner = np.concatenate([scale * terms.moments[:, :3, :3], information])
    outer = np.concatenate(
        [scale * terms.moments[:, :3, 3], np.einsum("pkl,pl->pk", information, off)]
    )
    motion = between(pose[second], pose[first])
    by_first = turned_axes(-pose[second, 2])
    by_second = -by_first
    by_second[:, 0, 2], by_second[:, 1, 2] = motion[:, 1], -motion[:, 0]
    ends = (first, by_first), (second, by_second)
    gradient, blocks = np.zeros((n, 3)), []
    for i, A in ends:
        np.add.at(gradient, i, np.einsum("pkl,pk->pl", A, outer))
        for j, B in ends:
            rows = np.broadcast_to(3 * i[:, None, None] + np.arange(3)[:, None], inner.shape)
            columns = np.broadcast_to(3 * j[:, None, None] + np.arange(3), inner.shape)
            values = A.transpose(0, 2, 1) @ inner @ B
            at = rows.ravel(), columns.ravel()
            blocks.append(sp.coo_matrix((values.ravel(), at), shape=(3 * n, 3 * n)).tocsc())
    held = sp.diags(np.concatenate([np.full(3, 1e10), np.full(3 * n - 3, 1e-6)])).tocsc()
    step = sla.splu(sum(blocks, held), **SYMMETRIC).solve(-gradient.ravel()).reshape(-1, 3)
    out = pose + step
    out[:, 2] = wrap(out[:, 2])
    return np.asarray(out)
