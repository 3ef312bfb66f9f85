"""The columns of one topic, its frames, and the choice of the clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..topology.arrays import BoolArray, IntArray
from ..topology.columns import joined, take
from ..topology.wording import listed
from .logs.intake import Sink
from .logs.messages import several_that
from .logs.poses import Poses, no_poses
from .odometry.jumps import times
from .odometry.track import backward_jumps

Clock = Literal["header", "log"]

MOST_LAG_S = 10.0
"""Largest lag that is looked for between two clocks: robots turn again, or are at another junction,
by then."""
LAG_STEP_S = 0.25
"""Step of the search: rotations of robots last longer."""
LEFT = 0.67
"""Largest share of the differences (root mean square) that may remain by the right lag, or the
right reading: half and less remains where scans of two buildings are stamped late by 0.15 s and
more, and all of it where they are of another drive."""
SAME_SHARE = 0.8
"""Least share of the steps, or of the drive-bys, that are for it."""


@dataclass(slots=True)
class TopicPoses:
    """The poses of one topic.

    frames: pairs (frame_id, child_frame_id) by the number used in `columns.frame`; messages: their
    number; failed: of these, not decoded; reason: why the first of them was not; unusable: numbers
    of further messages and poses that cannot be used, by noun and reason; rivals: other frames that
    could be the odometry's.
    """

    columns: Poses
    frames: tuple[tuple[str, str], ...]
    messages: int
    failed: int = 0
    reason: str = ""
    unusable: dict[tuple[str, str], int] = field(default_factory=dict)
    rivals: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, sinks: Sequence[Sink]) -> TopicPoses:
        """Join the columns of one topic; there are several if its definition changed during the
        recording."""
        frames: dict[tuple[str, str], int] = {}
        parts: list[Poses] = []
        before = 0
        for sink in sinks:
            columns = sink.columns()
            columns.message += before
            pairs = sink.decoder.frames.pairs
            numbers = [frames.setdefault(p, len(frames)) for p in pairs]
            if numbers != list(range(len(pairs))):
                columns.frame = np.array(numbers, np.int64)[columns.frame]
            parts.append(columns)
            before += sink.messages
        columns = _by_log_time(parts)
        unusable = {
            EMPTY: sum(sink.empty for sink in sinks),
            NOT_FINITE: sum(sink.not_finite for sink in sinks),
            NO_ROTATION: sum(sink.zero_quaternion for sink in sinks),
        }
        return cls(
            columns,
            tuple(frames),
            before,
            sum(sink.failed for sink in sinks),
            next((sink.reason for sink in sinks if sink.reason), ""),
            unusable,
        )

    def __len__(self) -> int:
        return len(self.columns.pose)

    def keep(self, rows: BoolArray) -> None:
        """Drop the poses that are not marked."""
        if not rows.all():
            self.columns = take(self.columns, rows)

    def time_ns(self, clock: Clock) -> IntArray:
        """Time of every pose by one of the two clocks [ns]."""
        return self.columns.log_ns if clock == "log" else self.columns.stamp_ns

    def warnings(self, topic: str) -> list[str]:
        """Warnings on messages that could not be used."""
        because = f" ({self.reason})" if self.reason else ""
        counts = {("message", f"could not be decoded{because}"): self.failed} | self.unusable
        out = [
            f"{topic}: {several_that(count, noun, why)}; left out"
            for (noun, why), count in counts.items()
            if count
        ]
        if self.rivals:
            pairs = listed_pairs(self.rivals)
            out.append(
                f"{topic}: also holds the odometry of another robot ({pairs}); left out; "
                "--base-frame chooses"
            )
        return out


FOREIGN = "message", "are of another type"
EMPTY = "message", "hold no pose"
ELSEWHERE = "pose", "are between other frames"
NOT_FINITE = "pose", "hold numbers that are not finite or absurdly large"
NO_ROTATION = "pose", "have a quaternion of zero length"


def listed_pairs(pairs: Sequence[tuple[str, str]]) -> str:
    """Pairs of frames in one line."""
    return listed([f"{parent} → {child}" if child else parent for parent, child in pairs], 5)


def _by_log_time(parts: Sequence[Poses]) -> Poses:
    """Columns of several channels, sorted by log time."""
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return no_poses()
    columns = joined(parts)
    return take(columns, np.argsort(columns.log_ns, kind="stable"))


def pair_of_transforms(poses: TopicPoses, base: str | None = None) -> int | None:
    """The frames (odom → base) in a topic of transforms, None if there are none.

    base: the child frame to look for. The parent is called `odom…` after the last slash; of several
    children a `base…` one is preferred, then the one with the most messages.
    """
    counts = np.bincount(poses.columns.frame, minlength=len(poses.frames))
    fit = [
        (not child.split("/")[-1].startswith("base"), -int(counts[number]), child, number)
        for number, (parent, child) in enumerate(poses.frames)
        if _is_odometry(parent) and counts[number] and base in (None, child)
    ]
    return min(fit)[-1] if fit else None


def _is_odometry(frame: str) -> bool:
    return frame.rsplit("/", maxsplit=1)[-1].startswith("odom")


def other_odometries(poses: TopicPoses, pair: int) -> tuple[tuple[str, str], ...]:
    """The other odom frames than that of `pair`, with their children, in a topic of transforms."""
    chosen = poses.frames[pair][0]
    return tuple(sorted(p for p in poses.frames if _is_odometry(p[0]) and p[0] != chosen))


def pair_of_poses(poses: TopicPoses, base: str | None = None) -> int | None:
    """The frames of most poses, None if there are no poses.

    base: the child frame to look for; a topic without a child frame matches any.
    """
    if len(poses) == 0:
        return None
    count = np.bincount(poses.columns.frame, minlength=len(poses.frames))
    if base is not None:
        count[[child not in ("", base) for _, child in poses.frames]] = 0
    return int(count.argmax()) if count.any() else None


def choose_clock(
    odometry: TopicPoses | None,
    others: TopicPoses,
    wanted: Clock,
    warnings: list[str],
    what: str = "junction",
) -> Clock:
    """The clock to use: the wanted one, or log time if header stamps are unusable, or were set
    back.

    others: the messages beside the odometry; what: their name, for the warnings.
    """
    for poses, name in ((odometry, "odometry"), (others, what)) if wanted == "header" else ():
        if poses is not None and 2 * int((poses.columns.stamp_ns == 0).sum()) > len(poses):
            warnings.append(f"{name} messages carry no header time; log time is used")
            return "log"
    if odometry is None or wanted == "log":
        return wanted
    if _apart(odometry, others, "header") and not _apart(odometry, others, "log"):
        warnings.append(
            f"header times of odometry and {what}s are of different clocks; log time is used"
        )
        return "log"
    jumps = backward_jumps(odometry.time_ns("header"))
    if jumps and not backward_jumps(odometry.time_ns("log")):
        warnings.append(f"the header clock goes back {times(jumps)}; log time is used")
        return "log"
    return "header"


def _apart(a: TopicPoses, b: TopicPoses, clock: Clock) -> bool:
    """Whether the times of two topics do not overlap at all."""
    if len(a) == 0 or len(b) == 0:
        return False
    first, second = a.time_ns(clock), b.time_ns(clock)
    return bool(first.max() < second.min() or second.max() < first.min())
