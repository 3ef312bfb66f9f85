"""The summary page of a map's recording, in Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..topology.driven_branches import driven_branches
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import counted, to_turning_points, utc
from .questions import Question

MOST_LINES = 40
"""Longer lists are cut; the JSON document has all entries."""


LEGEND = """\
Junctions are coloured by their branches: dead ends **red**, bends **grey**, three **blue**, four
**green**, more **violet**. Small **red** dots: the robot turned round, or its log begins or ends.
**Amber** arrows: branches never driven. Corridors are brighter the more often they were driven.
**Green** rings: closures, one for each time that the junction was recognised. **Red** lines (hidden
at first): two junctions that were not taken for one.

Thin tracks: the odometry as recorded (**grey**) and as corrected (**dark green**). **White**: the
robot at the cursor, behind it its last minute (**bright green**). **Violet** dots: raw detections,
a star of branches at the cursor; or junctions that scans show, dull where variants of the detector
do not agree. Under the map: walls that the laser saw (**slate**), or the grid that the
map was made from.

Drag the time line below: the robot drives. Point at anything for what is known about it, or select
it and open the panels at the top right; the left one shows and hides layers.
**Drift**: how far the recorded odometry is off the map, in metres, with 1 sigma of the map."""


def map_summary(topomap: TopoMap, asked: Sequence[Question]) -> str:
    """A Markdown page about one map: counts, a legend, closures, warnings."""
    parts = [
        f"# {plain(topomap.run)}",
        _counts(topomap),
        LEGEND if len(topomap) else "The map is empty: no junction was found in this run.",
        _closures(asked),
        _warnings(topomap),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def plain(text: object) -> str:
    """The text on one line, with Markdown's special characters escaped, also for tables."""
    line = " ".join(str(text).split())
    return "".join("\\" + c if c in "\\`*_{}[]<>#|~" else c for c in line)


def several(count: int, one: str, many: str = "") -> str:
    """A count with its noun, the number in bold: "**1** run", "**2** runs"."""
    number, _, noun = counted(count, one, many).partition(" ")
    return f"**{number}** {noun}"


def minutes(span_ns: int) -> str:
    """A duration as text: in seconds below two minutes, else in minutes."""
    seconds = span_ns / 1e9
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def bulleted(lines: Iterable[str], most: int = MOST_LINES) -> str:
    """A Markdown list, cut after `most` lines with a note of how many are left out."""
    every = list(lines)
    shown = [f"- {line}" for line in every[:most]]
    if len(every) > most:
        shown.append(f"- … and {len(every) - most} more, in the JSON document")
    return "\n".join(shown)


def _counts(topomap: TopoMap) -> str:
    whole, ways = with_turning_points(topomap), topomap.turning_points
    kinds = Counter(whole.kind)
    named = ", ".join(counted(n, kind.replace("_", " ")) for kind, n in sorted(kinds.items()))
    unseen = int((~driven_branches(whole)).sum())
    doubt = int(np.count_nonzero(topomap.confidence < 1))
    rows = [
        several(len(whole), "vertex", "vertices") + (f" ({plain(named)})" if named else ""),
        f"{several(len(topomap.source), 'corridor')}, {topomap.length.sum():,.0f} m"
        f"{to_turning_points(len(ways), ways.length.sum())}",
        several(len(topomap.observation_vertex), "pass", "passes") + _span(topomap),
        f"{several(unseen, 'branch', 'branches')} seen and never driven",
        f"{several(doubt, 'vertex', 'vertices')} that not all looks show so (confidence below 1)",
    ]
    return bulleted(rows if doubt else rows[:-1])


def _span(topomap: TopoMap) -> str:
    times = topomap.observation_time_ns
    if len(times) == 0:
        return ""
    first, last = int(times.min()), int(times.max())
    return f" in {minutes(last - first)}, from {utc(first)} UTC"


def _closures(asked: Sequence[Question]) -> str:
    if not asked:
        return ""
    # Questions that were revised in a later round are not in `asked`.
    refused = [q for q in asked if not q.closure.accepted]
    accepted = len(asked) - len(refused)
    head = f"## Loops\n\n{several(accepted, 'visit')} recognised"
    if not refused:
        return f"{head}, none refused."
    lines = (
        plain(q.told)
        for q in sorted(refused, key=lambda q: (-q.closure.bits, q.closure.time_b_ns, q.told))
    )
    return f"{head}, **{len(refused)}** refused:\n\n{bulleted(lines)}"


def _warnings(topomap: TopoMap) -> str:
    warnings = topomap.info.get("warnings") or ()
    if not warnings:
        return ""
    return "## Warnings\n\n" + bulleted(plain(w) for w in warnings)


def correction(topomap: TopoMap, name: str) -> float:
    """What the map was corrected by, by its name in `graph.calibration`; 0 if it was not."""
    told = topomap.info.get("calibration")
    error = told.get(name) if isinstance(told, Mapping) else None
    applied = error.get("applied") if isinstance(error, Mapping) else None
    return float(applied) if isinstance(applied, (int, float)) else 0.0
