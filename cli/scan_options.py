"""Options about scans, shared by `ingest` and `info`."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from ..topology.errors import UsageError

JunctionsFrom = Annotated[
    Literal["topic", "scan", "cloud", "grid"] | None,
    typer.Option(
        help="Where junctions come from: detections on a topic, or found in laser scans, clouds of "
        "points (sliced at the sensor's height), or the last occupancy grid; default: the first of "
        "these that the log has.",
    ),
]
ScanTopic = Annotated[
    str | None,
    typer.Option(
        metavar="TOPIC",
        help="Scans, clouds or grid to find junctions in; default: all lasers; else /points or "
        "/map, or the topic of its type with most messages.",
    ),
]
LaserPose = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,YAW",
        help="Pose of the laser on the robot, in metres and radians; default: from /tf_static or "
        "/tf, else at the robot's centre, in the direction that its scans show, or ahead.",
    ),
]
ScanStamp = Annotated[
    Literal["begin", "middle", "end"],
    typer.Option(
        help="Which beam of a sweep a scan's time stamp refers to. In ROS it is the first; some "
        "drivers stamp a scan when it is finished."
    ),
]
CloudBand = Annotated[
    str | None,
    typer.Option(
        metavar="LOW,HIGH",
        help="Heights in the robot's frame between which points of a cloud are walls, in metres; "
        "default: 0.2 below to 0.2 above the sensor.",
    ),
]
RobotRadius = Annotated[
    float,
    typer.Option(
        metavar="METRES",
        help="Radius of the robot that has to fit through the corridors of a saved map or a grid.",
    ),
]


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
