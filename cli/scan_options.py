"""Options about scans, which `ingest` and `info` share, and what is said of them afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import typer

from ..topology.errors import UsageError

JunctionsFrom = Annotated[
    Literal["topic", "scan", "cloud", "grid"] | None,
    typer.Option(
        help="How junctions come: as detections on a topic, or found in laser scans, in clouds of "
        "points (sliced at the sensor's height), or in the last occupancy grid; default: the first "
        "of these that the log has.",
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
        help="Where the laser is on the robot, in metres and radians; default: as /tf_static or "
        "/tf tell, else at the robot's middle, looking as its scans show, or ahead.",
    ),
]
ScanStamp = Annotated[
    Literal["begin", "middle", "end"],
    typer.Option(
        help="Which beam of a sweep the time of a scan is of. ROS says the first; some drivers "
        "stamp a scan when it is finished."
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


def numbers(text: str | None, flag: str, names: str) -> tuple[float, ...] | None:
    """Numbers separated by commas, None for None; UsageError where they are others than `names`."""
    if text is None:
        return None
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != len(names.split(",")):
        raise UsageError(f"{flag} is {text!r}, expected {names}, as in {flag}=0.2,0,0"[:200])
    return found


LEAST_TOLD = 0.005
"""Smaller shares are 0 %."""


def source_told(info: Mapping[str, Any]) -> str:
    """Where the junctions of a map came from, where that needs saying. info: of the map."""
    junctions = info.get("source", {}).get("junctions", {})
    way, topic = junctions.get("from"), junctions.get("topic")
    others = ", ".join(junctions.get("passed_over", ()))
    if way is None:
        if not others:
            return ""
        return f"; junctions from {topic}, not from {others} (--junctions-from scan takes these)"
    if way == "grid":
        return f"; junctions from the grid {topic}"
    told = [f"; junctions from {topic}"]
    if others:
        told.append(f"not from {others}")
    before, after = junctions.get("drift_before_m"), junctions.get("drift_after_m")
    if after is not None and before is not None and junctions.get("odometry"):
        told.append(f"drift in 20 m {before:.2f} m before, {after:.2f} m after matching scans")
    elif after is not None:
        told.append(f"drift in 20 m {after:.2f} m")
    if junctions.get("covered") is not None:
        told.append(f"{100 * junctions['covered']:.0f} % of the way covered")
    driven = info.get("driven", {})
    if "corridors" in driven:
        told.append(f"{100 * driven['corridors']:.0f} % of it along corridors")
    if driven.get("out_and_back", 0.0) >= LEAST_TOLD:
        told.append(f"{100 * driven['out_and_back']:.0f} % out of a junction and back to it")
    return ", ".join(told)
