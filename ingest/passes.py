"""Fusion of junction detections to passes: one row per drive by a junction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.circular import cluster_angles
from ..topology.columns import take
from ..topology.odometry import Odometry
from ..topology.passes import Passes, nearest_branch
from ..topology.ragged import Ragged
from ..topology.run import Detections, ScanPasses
from ..topology.se2 import apply, wrap
from ..topology.track import stretch_of, track_directions, way_at


@dataclass(frozen=True, slots=True)
class PassSettings:
    """How detections are grouped."""

    gap_s: float = 1.2
    """A longer silence ends a pass, if the robot moved meanwhile."""
    gap_way_m: float = 1.0
    """Distance driven in a silence that ends a pass."""
    jump_m: float = 0.8
    """A detection with its centre farther than this from the previous one begins a new pass."""
    cluster_gap_rad: float = 0.3
    """Branch readings farther apart than this belong to different branches."""
    least_support: float = 0.5
    """Share of a pass's messages that must report a branch."""
    least_messages_share: float = 0.12
    """Passes with a smaller share of the median number of messages are dropped as flicker."""


PASSES = PassSettings()


def fuse_passes(odometry: Odometry, detections: Detections) -> Passes:
    """The passes of a run, in the odometry frame.

    Detections outside the time of the odometry, and without any branch, are left out; the result
    may be empty. O(n + k log k) for n odometry rows and k branch readings.
    """
    if len(odometry) == 0 or len(detections) == 0:
        return no_passes()
    usable = (
        (detections.time_ns >= odometry.time_ns[0])
        & (detections.time_ns <= odometry.time_ns[-1])
        & (detections.branches.counts > 0)
        & ~_within_break(odometry, detections.time_ns)
    )
    if not usable.any():
        return no_passes()
    seen = take(detections, usable)
    centre = apply(odometry.at(seen.time_ns), seen.centre)
    keep, group = _without_flicker(_group(odometry, seen.time_ns, centre))
    seen, centre = take(seen, keep), centre[keep]
    time_ns, pose = seen.time_ns, odometry.at(seen.time_ns)
    counts = np.bincount(group)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    fused = _middle(centre, group, len(counts))
    # When nearest: the first row of each group in the order of distance.
    distance = np.hypot(*(pose[:, :2] - fused[group]).T)
    owner = seen.branches.owner
    heading = seen.branches.values + pose[owner, 2]
    return _with_ways(
        odometry,
        time_ns=time_ns[np.lexsort((distance, group))[offsets[:-1]]],
        start_ns=time_ns[offsets[:-1]],
        end_ns=time_ns[offsets[1:] - 1],
        centre=fused,
        branches=_cluster_branches(heading, owner, group[owner], counts),
        messages=counts,
        confidence=np.ones(len(counts)),
    )


def scanned_passes(odometry: Odometry, seen: ScanPasses) -> Passes:
    """The passes detected in scans, in the odometry frame."""
    if len(odometry) == 0 or len(seen) == 0:
        return no_passes()
    pose = odometry.at(seen.time_ns)
    owner = seen.branches.owner
    heading = np.asarray(wrap(seen.branches.values + pose[owner, 2]))
    return _with_ways(
        odometry,
        time_ns=seen.time_ns,
        start_ns=seen.start_ns,
        end_ns=seen.end_ns,
        centre=apply(pose, seen.centre),
        branches=Ragged(seen.branches.offsets, heading[np.lexsort((heading, owner))]),
        messages=seen.windows,
        confidence=seen.confidence,
    )


def _with_ways(
    odometry: Odometry, *, time_ns: IntArray, centre: FloatArray, branches: Ragged, **columns: Any
) -> Passes:
    """Passes with the branches by which the robot came and went; columns: the rest of `Passes`."""
    track = track_directions(odometry, time_ns, centre)
    entry, leaving = (nearest_branch(branches, way) for way in (track.arriving, track.leaving))
    return Passes(
        time_ns=time_ns, centre=centre, branches=branches, entry=entry, exit=leaving, **columns
    )


def no_passes() -> Passes:
    """The passes of a run without junctions."""
    none, empty = np.zeros(0, np.int64), Ragged.from_rows([])
    return Passes(none, none, none, np.zeros((0, 2)), empty, none, none, none, np.zeros(0))


def _within_break(odometry: Odometry, time_ns: IntArray) -> BoolArray:
    """(k,) detections between the two rows of a break or jump: the robot's position then is
    unknown."""
    row = np.searchsorted(odometry.time_ns, time_ns, side="left")
    broken = np.zeros(len(odometry) + 1, bool)
    broken[odometry.cuts] = True
    exact = odometry.time_ns[np.minimum(row, len(odometry) - 1)] == time_ns
    result: BoolArray = broken[row] & ~exact
    return result


def _group(odometry: Odometry, time_ns: IntArray, centre: FloatArray) -> IntArray:
    """(k,) index of the pass of each detection."""
    way = way_at(odometry, time_ns)
    silence = np.diff(time_ns) > PASSES.gap_s * 1e9
    moved = np.diff(way) > PASSES.gap_way_m
    jump = np.hypot(*np.diff(centre, axis=0).T) > PASSES.jump_m
    cut = np.diff(stretch_of(odometry, time_ns)) != 0
    new = (silence & moved) | jump | cut
    return np.concatenate([[0], np.cumsum(new)])


def _without_flicker(group: IntArray) -> tuple[BoolArray, IntArray]:
    """Drop groups far smaller than the median; returns the rows kept, and their groups
    renumbered."""
    counts = np.bincount(group)
    keep = (counts >= PASSES.least_messages_share * np.median(counts))[group]
    return keep, np.unique(group[keep], return_inverse=True)[1].astype(np.int64)


def _middle(xy: FloatArray, group: IntArray, groups: int) -> FloatArray:
    """Mean of each group's points without outliers (more than three median distances from the
    median)."""
    index = np.arange(groups)
    median = np.column_stack([ndimage.median(xy[:, k], group, index) for k in (0, 1)])
    away = np.hypot(*(xy - median[group]).T)
    usual = np.asarray(ndimage.median(away, group, index))
    weight = (away <= 3.0 * usual[group] + 1e-9).astype(np.float64)
    total = np.bincount(group, weight)
    return np.column_stack([np.bincount(group, weight * xy[:, k]) / total for k in (0, 1)])


def _cluster_branches(
    heading: FloatArray, message: IntArray, group: IntArray, messages: IntArray
) -> Ragged:
    """Branches of each pass, ascending.

    A branch counts if enough of the messages report it; the most frequent one always does.
    """
    clusters = cluster_angles(heading, group, PASSES.cluster_gap_rad)
    share = clusters.votes(message) / messages[clusters.owner]
    keep = clusters.well_seen(share, PASSES.least_support)
    return Ragged.by_owner(clusters.owner[keep], clusters.mean[keep], len(messages))
