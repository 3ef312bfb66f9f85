"""Mounting of sensors on the robot: from the transforms of the log, from the user, or assumed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from ..topology.arrays import FloatArray
from .frames import NOWHERE_ELSE, FixedTransforms, fixed_transforms
from .logs.recording import Recording
from .read_settings import ReadSettings
from .scans.slicing import mount_of_camera
from .scans.stream import Mounting

BODIES = ("base_link", "base_footprint", "base")
"""Usual names of the robot's frame, for logs without odometry, which would name it."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownMounting:
    """Sensors whose mounting the log states.

    known: (7,) T_body_sensor by frame; body: the robot's frame; fixed: all transforms of the log,
    None if they were not needed.
    """

    known: Mapping[str, FloatArray]
    body: str
    fixed: FixedTransforms | None = None

    def knows(self, frames: Collection[str]) -> bool:
        """Whether the mounting of all these frames is known."""
        return all(frame in self.known for frame in frames)


def known_mounting(
    recording: Recording, frames: Collection[str], body: str | None
) -> KnownMounting:
    """The mounting of sensors with these frames, by the transforms of a log.

    body: the robot's frame, the odometry's child; None: one of the usual names. The log is read
    again only if a frame is none of these.
    """
    bodies = (body,) if body is not None else BODIES
    known = dict.fromkeys(("", *bodies), NOWHERE_ELSE)
    foreign = set(frames) - set(known)
    if not foreign:
        return KnownMounting(known, bodies[0])
    fixed = fixed_transforms(recording)
    robot = next((b for b in bodies if foreign & set(fixed.connected_to(b))), bodies[0])
    return KnownMounting(known | fixed.connected_to(robot), robot, fixed)


def mounting(
    where: KnownMounting,
    frames: Collection[str],
    settings: ReadSettings,
    yaw_of: Callable[[str], float | None] | None = None,
) -> tuple[Mounting, list[str]]:
    """The mounting of the sensors with these frames, and warnings on what was assumed.

    yaw_of: estimates the yaw [rad] of the sensor of a frame from its motion, None if uncertain;
    called if the log does not state it. None: there is no odometry, and the robot's frame is the
    sensor's own.
    """
    if settings.laser_pose is not None:
        x, y, yaw = settings.laser_pose
        pose = planar(x, y, yaw)
        return Mounting(otherwise=lambda _: pose), []
    lost = sorted(name for name in set(frames) if name not in where.known)
    if not lost:
        return Mounting(where.known, mount_of_camera), []
    names = ", ".join(map(repr, lost[:5]))
    unknown = f"the log does not say where frame {names} is on the robot"
    if yaw_of is None:
        return Mounting(where.known, mount_of_camera), [
            f"{unknown}, and there is no odometry to tell: if it is upside down, the map is a "
            f"mirror image ({where.fixed})"
        ]
    yaws = {name: yaw_of(name) for name in lost if mount_of_camera(name) is NOWHERE_ELSE}
    facing = {name: yaw for name, yaw in yaws.items() if yaw is not None}
    turned = {name: planar(0.0, 0.0, yaw) for name, yaw in facing.items()}
    looks = "".join(f"; {name!r} looks {_looking(yaw)}" for name, yaw in facing.items())
    return Mounting(where.known, lambda name: turned.get(name, mount_of_camera(name))), [
        f"{unknown} ({where.body!r}); taken to be at its middle and to look "
        f"{'as its scans and the odometry show' if looks else 'ahead'}{looks}; "
        f"--laser-pose x,y,yaw tells ({where.fixed})"
    ]


def planar(x: float, y: float, yaw: float) -> FloatArray:
    """(7,) pose of an upright sensor."""
    return np.array([x, y, 0.0, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])


def _looking(yaw_rad: float) -> str:
    degrees = round(float(np.degrees(yaw_rad)))
    if degrees == 0:
        return "ahead"
    return f"{abs(degrees)} degrees to the {'left' if degrees > 0 else 'right'}"
