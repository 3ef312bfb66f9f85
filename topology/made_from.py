"""Where the junctions of a map came from, in words."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

LEAST_TOLD = 0.01
"""Smaller shares of the way are not mentioned."""

USUAL_DRIFT_M, USUALLY_COVERED, USUALLY_MAPPED = 0.12, 0.95, 0.9
"""What 95 of 100 laser maps reach: drift in 20 m after matching scans, shares of the way that scans
cover, and of that what leads along corridors. Measured on 118 maps of simulated offices and of four
real buildings (intel, aces, acapulco, fr101): 0.12 m, 0.97 and 0.92."""


def describe_unusual(info: Mapping[str, Any]) -> str:
    """What is worse about a map from scans than about most of them, "" if nothing; info: as for
    `describe_junctions`."""
    junctions = _inside(_inside(info, "source"), "junctions")
    drift, covered = _number(junctions, "drift_after_m"), _number(junctions, "covered")
    mapped = _number(_inside(info, "driven"), "corridors")
    parts = []
    if drift is not None and drift > USUAL_DRIFT_M:
        usual = f"usually {USUAL_DRIFT_M:g} m at most"
        parts.append(f"drift in 20 m {drift:.2f} m after matching scans ({usual})")
    if covered is not None and covered < USUALLY_COVERED:
        parts.append(f"scans cover {covered:.0%} of the way")
    if mapped is not None and mapped < USUALLY_MAPPED:
        parts.append(f"{mapped:.0%} of the way is on the map")
    return ", ".join(parts)


def describe_junctions(info: Mapping[str, Any]) -> str:
    """Source of a map's junctions, drift before and after scan matching, and shares of the way
    driven.

    info: of the map, possibly from a foreign document: what is not as `ingest` writes it is left
    out. Empty where detections were read and there was nothing else to choose from.
    """
    junctions = _inside(_inside(info, "source"), "junctions")
    way, topic = junctions.get("from"), junctions.get("topic")
    passed_over = junctions.get("passed_over", ())
    others = ", ".join(map(str, passed_over)) if isinstance(passed_over, list | tuple) else ""
    if way is None:
        if not others:
            return ""
        sensor = _inside(_inside(info, "source"), "views").get("topic")
        shown = f"; walls around places from {sensor}" if sensor else ""
        takes = "(--junctions-from scan takes these)"
        return f"junctions from {topic}, not from {others} {takes}{shown}"
    if way == "grid":
        return f"junctions from the grid {topic}"
    parts = [f"junctions from {topic}"]
    if others:
        parts.append(f"not from {others}")
    before, after = (_number(junctions, f"drift_{when}_m") for when in ("before", "after"))
    if after is not None and before is not None and junctions.get("odometry"):
        parts.append(f"drift in 20 m {before:.2f} m before, {after:.2f} m after matching scans")
    elif after is not None:
        parts.append(f"drift in 20 m {after:.2f} m")
    driven = _inside(info, "driven")
    shares = (
        (_number(junctions, "covered"), "of the way covered", 0.0),
        (_number(driven, "corridors"), "of it along corridors or to turning points", 0.0),
        (_number(driven, "out_and_back"), "out of a junction and back to it", LEAST_TOLD),
    )
    parts += [
        f"{100 * s:.0f} % {what}" for s, what, least in shares if s is not None and s >= least
    ]
    return ", ".join(parts)


def _inside(info: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = info.get(key)
    return value if isinstance(value, Mapping) else {}


def _number(info: Mapping[str, Any], key: str) -> float | None:
    value = info.get(key)
    if not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        return None
    return float(value)
