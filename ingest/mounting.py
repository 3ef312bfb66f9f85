"""Where sensors are on the robot: by the transforms of the log, as the user says, or assumed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

import numpy as np
from numpy.typing import NDArray

from ..topology.odometry import Odometry
from .frames import NO_TRANSFORMS, NOWHERE_ELSE, FixedCollector, FixedTransforms
from .logs.intake import Intake
from .logs.recording import Recording
from .logs.topics import TRANSFORM_KINDS
from .read_settings import ReadSettings
from .scans.mount_yaw import MountYaw
from .scans.slicing import mount_of_camera
from .scans.stream import Mounting
from .sightings import side_of
from .survey import walk

BODIES = ("base_link", "base_footprint", "base")
"""Usual names of the robot's frame, for logs without odometry, which would tell it."""
AHEAD = np.array(NOWHERE_ELSE)


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
    yaw_of: Callable[[str], MountYaw | None] = lambda _: None,
) -> tuple[Mounting, list[str]]:
    """Where the sensors with these frames are on the robot, and what had to be assumed.

    The robot's frame is the odometry's child frame; without odometry one of the usual names, else
    the sensor's own. yaw_of: which way the sensor of a frame looks by what it saw, None if that is
    not sure; asked where the log does not say.
    """
    if settings.laser_pose is not None:
        x, y, yaw = settings.laser_pose
        told = planar(x, y, yaw)
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
    yaws = {name: yaw_of(name) for name in lost if np.array_equal(mount_of_camera(name), AHEAD)}
    facing = {name: yaw for name, yaw in yaws.items() if yaw is not None}
    turned = {name: planar(0.0, 0.0, yaw.yaw_rad) for name, yaw in facing.items()}
    looks = "".join(f"; {name!r} looks {_told(yaw)}" for name, yaw in facing.items())
    return Mounting(known, lambda name: turned.get(name, mount_of_camera(name))), [
        f"the log does not say where frame {names} is on the robot ({body!r}); taken to be at its "
        f"middle and to look {'as its scans and the odometry show' if looks else 'ahead'}{looks}; "
        f"--laser-pose x,y,yaw tells ({fixed})"
    ]


def planar(x: float, y: float, yaw: float) -> NDArray[np.float64]:
    """(7,) pose of a sensor that stands upright."""
    return np.array([x, y, 0.0, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])


def _told(yaw: MountYaw) -> str:
    degrees = round(float(np.degrees(yaw.yaw_rad)))
    if degrees == 0:
        return "ahead"
    return f"{abs(degrees)} degrees to the {'left' if degrees > 0 else 'right'}"
