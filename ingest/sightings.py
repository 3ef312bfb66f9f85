"""From the poses of detection messages to junction sightings in the robot's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..topology.odometry import Odometry
from ..topology.ragged import Ragged
from ..topology.se2 import apply, inverse, wrap
from .logs.intake import PoseColumns
from .run import Detections

Ints = NDArray[np.int64]
Side = Literal["robot", "odometry", "foreign"]


@dataclass(frozen=True, slots=True)
class SightingSettings:
    """What is believed to be a sighting of one junction.

    outside_s: how far beyond the odometry's first and last time a sighting may lie; centre_m: how
    far apart the poses of one message may lie before it is reported.
    """

    max_branches: int = 32
    outside_s: float = 1.0
    centre_m: float = 0.5


@dataclass(frozen=True, slots=True)
class Sightings:
    """Detections, how many messages they leave out, and why."""

    detections: Detections
    warnings: tuple[str, ...]


def side_of(frame: str, odometry_frame: str, child_frame: str) -> Side:
    """Which frame of the odometry a detection's frame is."""
    if frame in ("", child_frame):
        return "robot"
    return "odometry" if frame == odometry_frame else "foreign"


def robot_frame_sightings(
    columns: PoseColumns,
    time_ns: Ints,
    frames: Sequence[str],
    odometry: Odometry,
    settings: SightingSettings = SightingSettings(),
) -> Sightings:
    """One sighting per junction of a message, in the robot's frame at the message's time, by time.

    time_ns: (k,) time of each pose's message; frames: name of every frame number. Messages in a
    frame that is neither of the odometry's, with implausibly many branches, or outside the
    odometry's time are left out.
    """
    warnings: list[str] = []
    new = np.diff(columns.message, prepend=-1) != 0
    new[1:] |= np.diff(columns.part.astype(np.int64)) != 0
    first = np.flatnonzero(new)
    counts = np.diff(np.append(first, len(columns.message)))
    rows = Ragged(np.append(first, len(columns.message)).astype(np.int64), columns.pose[:, 2])
    centre = _centres(columns.pose[:, :2], first, counts, settings, warnings)
    time = time_ns[first]
    sides = [side_of(frame, odometry.frame, odometry.child_frame) for frame in frames]
    foreign = [frame for frame, side in zip(frames, sides, strict=True) if side == "foreign"]
    side = np.array(sides, dtype="U8")[columns.frame[first]]

    outside = settings.outside_s * 1e9
    keep = _leave_out(
        np.ones(len(side), bool), side != "foreign", warnings, _expected(foreign, odometry)
    )
    keep = _leave_out(
        keep,
        counts <= settings.max_branches,
        warnings,
        f"have more than {settings.max_branches} branches",
    )
    within = (time >= odometry.time_ns[0] - outside) & (time <= odometry.time_ns[-1] + outside)
    keep = _leave_out(keep, within, warnings, "lie outside the time of the odometry")

    chosen = np.flatnonzero(keep)
    chosen = chosen[np.argsort(time[chosen], kind="stable")]
    branches, centre, time = rows.take(chosen), centre[chosen], time[chosen]
    in_odometry = side[chosen] == "odometry"
    if in_odometry.any():
        T_odom_base = odometry.at(time)
        turned = apply(inverse(T_odom_base), centre)
        centre = np.where(in_odometry[:, None], turned, centre)
        heading = np.where(in_odometry, T_odom_base[:, 2], 0.0)
        yaw = wrap(branches.values - heading[branches.owner])
        branches = Ragged(branches.offsets, yaw)
    return Sightings(Detections(time, centre, branches), tuple(warnings))


def _expected(foreign: Sequence[str], odometry: Odometry) -> str:
    names = ", ".join(map(repr, sorted(set(foreign))[:5]))
    return f"are in frame {names}, expected {odometry.child_frame!r} or {odometry.frame!r}"


def _centres(
    xy: NDArray[np.float64],
    first: Ints,
    counts: NDArray[np.int64],
    settings: SightingSettings,
    warnings: list[str],
) -> NDArray[np.float64]:
    """(m, 2) mean position of every message's poses; they should coincide."""
    if len(first) == 0:
        return np.zeros((0, 2))
    # Relative to the first pose of each message, so that equal positions give exactly that one.
    origin = xy[first]
    away = xy - np.repeat(origin, counts, axis=0)
    spread = np.maximum.reduceat(np.abs(away).max(axis=1), first)
    apart = int((spread > settings.centre_m).sum())
    if apart:
        warnings.append(
            f"{apart} detections spread their branches over more than {settings.centre_m} m; "
            "their mean is taken as the centre"
        )
    return np.asarray(origin + np.add.reduceat(away, first, axis=0) / counts[:, None])


def _leave_out(
    keep: NDArray[np.bool_], good: NDArray[np.bool_], warnings: list[str], why: str
) -> NDArray[np.bool_]:
    bad = int((keep & ~good).sum())
    if bad:
        warnings.append(f"{bad} detections {why}; left out")
    return keep & good
