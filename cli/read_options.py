"""Options about reading logs and making maps, shared by `ingest`, `info` and `init`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..ingest.remote.path import LogPath, log_path
from ..topology.errors import LogError, UsageError
from .output import warn

if TYPE_CHECKING:
    from ..ingest.mapping_settings import MappingSettings
    from ..ingest.reading import ReadSettings


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Which logs are read, and how."""

    odometry_topic: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="Odometry topic; default: the only one of the best known type, else /odom.",
        ),
    ] = None
    junction_topic: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="Junction detections; default: /junctions, else the only PoseArray topic.",
        ),
    ] = None
    junction_fields: Annotated[
        str | None,
        typer.Option(
            metavar="MAPPING",
            # An example that no line breaks: it is there to be copied.
            help="How to read junctions from messages of another type, for instance "
            '"center=middle,branches=ways[].angle"; see docs/detections.md.',
        ),
    ] = None
    junctions_from: Annotated[
        Literal["topic", "scan", "cloud", "grid"] | None,
        typer.Option(
            help="Where junctions come from: detections on a topic, or found in laser scans, "
            "clouds of points (sliced at the sensor's height), or the last occupancy grid; "
            "default: the first of these that the log has.",
        ),
    ] = None
    scan_topic: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="Scans, clouds or grid to find junctions in; default: all lasers; else /points or "
            "/map, or the topic of its type with most messages.",
        ),
    ] = None
    laser_pose: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,YAW",
            help="Pose of the laser on the robot, in metres and radians; default: from /tf_static "
            "or /tf, else at the robot's centre, in the direction that its scans show, or ahead.",
        ),
    ] = None
    scan_stamp: Annotated[
        Literal["begin", "middle", "end"],
        typer.Option(
            help="Which beam of a sweep a scan's time stamp refers to. In ROS it is the first; "
            "some drivers stamp a scan when it is finished."
        ),
    ] = "begin"
    cloud_band: Annotated[
        str | None,
        typer.Option(
            metavar="LOW,HIGH",
            help="Heights in the robot's frame between which points of a cloud are walls, in "
            "metres; default: 0.2 below to 0.2 above the sensor.",
        ),
    ] = None
    base_frame: Annotated[
        str | None,
        typer.Option(
            metavar="FRAME",
            help="The robot's frame, if a topic such as /tf holds the odometry of several robots.",
        ),
    ] = None
    time: Annotated[
        Literal["header", "log"],
        typer.Option(help="Take times from message headers or from when the log received them."),
    ] = "header"
    separate: Annotated[
        bool,
        typer.Option(
            "--separate",
            help="Take parts of a split recording (run_0.bag, run_1.bag) as runs of their own.",
        ),
    ] = False
    allow_scan: Annotated[
        bool,
        typer.Option(
            "--allow-scan",
            help="Read remote logs without an index whole, instead of refusing them.",
        ),
    ] = False

    def settings(self, *, strict: bool = False) -> ReadSettings:
        """The settings; UsageError for numbers that are none."""
        from ..ingest.reading import ReadSettings
        from ..ingest.scans.slicing import SliceSettings

        finding = ("separate", "allow_scan", "laser_pose", "cloud_band")
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in finding}
        pose: Any = numbers(self.laser_pose, "--laser-pose", "x,y,yaw")
        band: Any = numbers(self.cloud_band, "--cloud-band", "low,high")
        return ReadSettings(laser_pose=pose, slices=SliceSettings(band), strict=strict, **plain)

    def logs(self, named: Sequence[str]) -> tuple[list[LogPath], list[tuple[LogPath, LogError]]]:
        """The logs at the named places, and the places without any, each with the reason. Warns of
        logs that are to be unpacked first."""
        from .run_logs import logs_of

        places = [log_path(name, allow_scan=self.allow_scan) for name in named]
        logs, missing, warnings = logs_of(places, separate=self.separate)
        for each in warnings:
            warn(each)
        return logs, missing


@dataclass(frozen=True, slots=True)
class MapOptions:
    """How a map is made of what was read."""

    robot_radius: Annotated[
        float,
        typer.Option(
            metavar="METRES",
            help="Radius of the robot that has to fit through the corridors of a saved map or a "
            "grid.",
        ),
    ] = 0.25
    closure: Annotated[
        Literal["none", "full"],
        typer.Option(help="Whether to close loops: not at all, or by everything that is known."),
    ] = "full"

    def settings(self) -> MappingSettings:
        """The settings."""
        from ..ingest.mapping_settings import MappingSettings

        return MappingSettings(closure=self.closure, robot_radius_m=self.robot_radius)


def numbers(text: str | None, flag: str, names: str) -> tuple[float, ...] | None:
    """Comma-separated numbers, None for None; UsageError unless they are as many as `names`."""
    if text is None:
        return None
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != len(names.split(",")):
        raise UsageError(f"{flag} is {text!r}, expected {names}, as in {flag}=0.2,0,0"[:200])
    return found
