"""Maps, merges, corridors and closures in words, and the summary pages of recordings, in
Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..merge.result import MergeResult, Standing, pairs_of, shown_bits
from ..topology.arrays import IntArray
from ..topology.driven_branches import driven_branches
from ..topology.ragged import numbered
from ..topology.topomap import Closure, Graph, TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import counted, to_turning_points, utc
from .geometry import TURNED

MAP_LEGEND = """\
Junctions are coloured by their branches: dead ends **red**, bends **grey**, three **blue**, four
**green**, more **violet**. Small **red** dots: the robot turned round, or its log begins or ends.
**Amber** arrows: branches never driven. Corridors are brighter the more often they were driven.
**Green** rings: closures, one for each time that the junction was recognised. **Red** lines (hidden
at first): two junctions that were not taken for one.

Thin tracks: the odometry as recorded (**grey**) and as corrected (**dark green**). **White**: the
robot at the cursor, behind it its last minute (**bright green**). **Violet** dots: raw detections,
a star of branches at the cursor; or junctions that scans show, dull where variants of the detector
do not agree. Under the map: walls that the laser saw (**dark grey**), or the grid that the
map was made from.

Drag the time line below: the robot drives. Point at anything for what is known about it, or select
it and open the panels at the top right; the left one shows and hides layers.
**Drift**: how far the recorded odometry is off the map, in metres, with 1 sigma of the map."""

MERGE_LEGEND = """\
## How to read it

**Map**: every corridor is a ribbon with one strand for each run that drove it, in the colour of
its name; junctions seen by several runs are white, others grey. **Red** dots:
where joined runs contradict each other. Under the map: what the lasers of all runs saw, walls
**dark grey**, free space a little brighter than what is not known. Short strokes: branches that
nobody drove; wide violet lines: what to record next. **Runs**: each run's own map, laid into its
component.

The verdict on every pair of runs, with its evidence: `topobatch report`.

Point at anything for what is known about it, or select it and open the panels at the top right;
the left one shows and hides runs."""


def describe_map(topomap: TopoMap) -> str:
    """Counts of a map in a line."""
    ways, passes = topomap.turning_points, len(topomap.observation_vertex)
    rooms = {kind: count for kind in ("room", "door") if (count := topomap.kind.count(kind))}
    junctions = len(topomap) - sum(rooms.values())
    parts = [
        *([counted(junctions, "junction")] if junctions or not rooms else []),
        *(counted(count, kind) for kind, count in rooms.items()),
        counted(len(topomap.source), "corridor"),
        f"{topomap.length.sum():,.0f} m{to_turning_points(len(ways), ways.length.sum())}",
    ]
    return ", ".join(parts) + (f"; {counted(passes, 'pass', 'passes')}" if passes else "")


def describe_corridor(graph: Graph, edge: int) -> str:
    """A corridor, or the way to a turning point, in a line."""
    ends = (int(graph.source[edge]), int(graph.target[edge]))
    turned = next((graph.kind[v] for v in ends if graph.kind[v] in TURNED), None)
    what = f"corridor {ends[0]} to {ends[1]}"
    if turned is not None:
        what = f"way from junction {min(ends)} to where {TURNED[turned]}"
    return (
        f"{what}: {graph.length[edge]:.2f} ± {graph.length_sigma[edge]:.2f} m, "
        f"driven {counted(int(graph.traversals[edge]), 'time')}"
    )


def describe_pairs(result: MergeResult) -> str:
    """Counts of all pairs by verdict, in a line."""
    runs = sum(len(component.poses) for component in result.components)
    count = result.standings()
    others, kept_out = count[Standing.JOINED], count[Standing.KEPT_OUT]
    return (
        f"{counted(pairs_of(runs), 'pair')}: {count[Standing.MERGED]:,} merged, "
        f"{f'{others:,} joined through others, ' if others else ''}"
        f"{count[Standing.AMBIGUOUS]:,} ambiguous, "
        f"{count[Standing.UNRELATED]:,} unrelated"
        f"{f', {kept_out:,} kept out' if kept_out else ''}; "
        f"{result.described_sites}"
    )


@dataclass(frozen=True, slots=True)
class ClosureText:
    """A closure and the rows of its two observations (None: that pass belongs to no vertex), with
    its text."""

    closure: Closure
    rows: tuple[int | None, int | None]
    text: str


def visits(topomap: TopoMap) -> IntArray:
    """(k,) number of each observation among those of its vertex, from 1 on."""
    out = np.zeros(len(topomap.observation_vertex), np.int64)
    out[np.argsort(topomap.observation_vertex, kind="stable")] = numbered(topomap.passes)[1] + 1
    return out


def closure_texts(topomap: TopoMap) -> list[ClosureText]:
    """Every closure that no later round revised, with its text."""
    row = {t: k for k, t in enumerate(topomap.observation_time_ns.tolist())}
    visit = visits(topomap)
    out = []
    for closure in topomap.closures:
        if not closure.revised:
            rows = (row.get(closure.time_a_ns), row.get(closure.time_b_ns))
            out.append(ClosureText(closure, rows, _describe_closure(topomap, visit, closure, rows)))
    return out


def _describe_closure(
    topomap: TopoMap, visit: IntArray, closure: Closure, rows: tuple[int | None, int | None]
) -> str:
    """What a closure identified or refused, in a line."""
    names = [
        "a pass that is no junction"
        if k is None
        else f"junction {topomap.observation_vertex[k]} (visit {visit[k]})"
        for k in rows
    ]
    bits = f"{closure.bits:+.1f} bits"
    if closure.accepted and None not in rows:
        a, b = (int(visit[k]) for k in rows if k is not None)
        at = int(topomap.observation_vertex[rows[1] or 0])
        return f"junction {at}: visit {b} recognised as visit {a}, {bits}: {closure.reason}"
    word = "recognised as" if closure.accepted else "not taken for"
    return f"{names[1]} {word} {names[0]}, {bits}: {closure.reason}"


def map_page(topomap: TopoMap, closures: Sequence[ClosureText]) -> str:
    """The page about one map: counts, legend, warnings."""
    unseen = int((~driven_branches(with_turning_points(topomap))).sum())
    refused = sum(not q.closure.accepted for q in closures)
    counts = [
        f"{describe_map(topomap)}{_span(topomap)}",
        f"{counted(unseen, 'branch', 'branches')} seen and never driven",
        f"{counted(len(closures) - refused, 'visit')} recognised, {refused:,} refused",
    ]
    empty = "The map is empty: no junction was found in this run."
    return _page(topomap.run, counts, MAP_LEGEND if len(topomap) else empty, topomap.info)


def merge_page(result: MergeResult) -> str:
    """The page about a merge: counts, legend, warnings."""
    fused = result.fused
    corridors_m, ways_m = fused.lengths_m
    shared = sum(len(members) > 1 for members in fused.members[: fused.junctions])
    counts = [
        describe_pairs(result),
        f"{counted(fused.junctions, 'junction')}, {shared:,} of them seen by several runs",
        f"{counted(fused.corridors, 'corridor')}, {corridors_m:,.0f} m"
        f"{to_turning_points(fused.turned, ways_m)}",
    ]
    if result.threshold_bits is not None:
        counts.append(f"merging needs {shown_bits(result.threshold_bits)} bits")
    return _page("Merged map", counts, MERGE_LEGEND, result.info)


def _page(title: str, counts: Sequence[str], legend: str, info: Mapping[str, Any]) -> str:
    """A page of Markdown. counts: lines of a list; info: of the document, with its warnings."""
    parts = [f"# {plain(title)}", bulleted(counts), legend]
    if warnings := info.get("warnings"):
        parts.append("## Warnings\n\n" + bulleted([plain(w) for w in warnings]))
    return "\n\n".join(parts) + "\n"


def plain(text: object) -> str:
    """The text on one line, with Markdown's special characters escaped, also for tables."""
    line = " ".join(str(text).split())
    return "".join("\\" + c if c in "\\`*_{}[]<>#|~" else c for c in line)


def minutes(span_ns: int) -> str:
    """A duration as text: in seconds below two minutes, else in minutes."""
    seconds = span_ns / 1e9
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def bulleted(lines: Sequence[str]) -> str:
    """A Markdown list."""
    return "\n".join(f"- {line}" for line in lines)


def _span(topomap: TopoMap) -> str:
    """How long a run took, and when it began."""
    times = topomap.observation_time_ns
    if len(times) == 0:
        return ""
    first, last = int(times.min()), int(times.max())
    return f" in {minutes(last - first)}, from {utc(first)} UTC"
