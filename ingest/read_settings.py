"""Settings of reading a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from ..topology.errors import UsageError, check_choice
from .logs.fields import JunctionFields
from .logs.topics import Way
from .scans.slicing import SliceSettings
from .topic_poses import Clock

Stamp = Literal["begin", "middle", "end"]
"""The beam that the time of a scan refers to."""


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """What to read from a log, and how.

    odometry_topic, junction_topic, scan_topic: None finds them; base_frame: the robot's frame, if a
    topic holds the odometry of several; junction_fields: the fields of any other message that form
    a junction ("center=pose.position,branches=frontiers[].angle"); junctions_from: source of
    junctions, None takes the first available one; laser_pose: x, y [m], yaw [rad] of the scans'
    frame on the robot, None finds it; scan_stamp: the beam that the time of a scan refers to; time:
    the clock to use; strict: refuse a damaged log instead of using what remains.
    """

    odometry_topic: str | None = None
    junction_topic: str | None = None
    scan_topic: str | None = None
    base_frame: str | None = None
    junction_fields: str | None = None
    junctions_from: Way | None = None
    laser_pose: tuple[float, float, float] | None = None
    scan_stamp: Stamp = "begin"
    slices: SliceSettings = field(default_factory=SliceSettings)
    time: Clock = "header"
    strict: bool = False

    def __post_init__(self) -> None:
        check_choice("--time", self.time, get_args(Clock))
        check_choice("--scan-stamp", self.scan_stamp, get_args(Stamp))
        check_choice("--junctions-from", self.junctions_from, (*get_args(Way), None))
        pose = self.laser_pose
        if pose is not None and (np.shape(pose) != (3,) or not np.isfinite(pose).all()):
            raise UsageError(f"--laser-pose is {pose}, which is no place X, Y, YAW")
        if self.junction_fields is not None:
            JunctionFields.parse(self.junction_fields)
            named = self.odometry_topic
            if named is not None and f"/{named.strip('/')}" == self.mapped_topic:
                raise UsageError(f"{self.mapped_topic} cannot be both odometry and junctions")

    @property
    def mapped_topic(self) -> str | None:
        """The topic that `junction_fields` applies to."""
        if self.junction_fields is None:
            return None
        return "/" + (self.junction_topic or "junctions").strip("/")


DEFAULT_READ = ReadSettings()
