"""Where sensors are on the robot: by the transforms of the log, as the user says, or assumed."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from ..topology.odometry import Odometry
from .frames import NO_TRANSFORMS, NOWHERE_ELSE, FixedCollector, FixedTransforms
from .logs.intake import Intake
from .logs.recording import Recording
from .logs.topics import TRANSFORM_KINDS
from .read_settings import ReadSettings
from .scans.slicing import mount_of_camera
from .scans.stream import Mounting
from .sightings import side_of
from .survey import walk

BODIES = ("base_link", "base_footprint", "base")
"""Usual names of the robot's frame, for logs without odometry, which would tell it."""


def transforms_about(
    recording: Recording, frames: Iterable[str], odometry: Odometry
) -> FixedTransforms:
    """How frames of the robot lie to each other; the log is read again only where that is asked."""
    if all(side_of(name, odometry.frame, odometry.child_frame) != "foreign" for name in frames):
        return NO_TRANSFORMS
    return fixed_transforms(recording)


def fixed_transforms(recording: Recording) -> FixedTransforms:
    """All transforms of a log that stay the same. Reads the log again."""
    collector = FixedCollector()
    intake = Intake(lambda channel: channel.type_name in TRANSFORM_KINDS, collector.decoder_for)
    walk(recording, intake, None)
    for sink in intake.sinks:
        sink.flush()
    return collector.found


def mounting(
    recording: Recording,
    frames: Collection[str],
    odometry: Odometry | None,
    settings: ReadSettings,
) -> tuple[Mounting, list[str]]:
    """Where the sensors with these frames are on the robot, and what had to be assumed.

    The robot's frame is the odometry's child frame; without odometry one of the usual names, else
    the sensor's own.
    """
    if settings.laser_pose is not None:
        x, y, yaw = settings.laser_pose
        told = np.array([x, y, 0.0, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
        return Mounting(otherwise=lambda _: told), []
    bodies = (odometry.child_frame,) if odometry is not None else BODIES
    known = dict.fromkeys(("", *bodies), np.array(NOWHERE_ELSE))
    foreign = sorted(set(frames) - set(known))
    if not foreign:
        return Mounting(known, mount_of_camera), []
    fixed = fixed_transforms(recording)
    body = next((b for b in bodies if set(foreign) & set(fixed.joined_to(b))), bodies[0])
    known |= fixed.joined_to(body)
    lost = [name for name in foreign if name not in known]
    if not lost or odometry is None:
        return Mounting(known, mount_of_camera), []
    names = ", ".join(map(repr, lost[:5]))
    return Mounting(known, mount_of_camera), [
        f"the log does not say where frame {names} is on the robot ({body!r}); taken to be at its "
        f"middle and to look ahead; --laser-pose x,y,yaw tells ({fixed})"
    ]
