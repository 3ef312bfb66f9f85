"""What a map's recording says in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime

import numpy as np

from ..topology.topomap import Closure, TopoMap
from .drawing import driven_branches

MOST_LINES = 40
"""Longer lists are cut: the document has them all."""


def map_summary(topomap: TopoMap) -> str:
    """A page of markdown about one map: counts, loops, noise, warnings, how to read the picture."""
    parts = [
        f"# {plain(topomap.run)}",
        _counts(topomap),
        _legend(topomap),
        _closures(topomap.closures),
        _warnings(topomap),
        _source(topomap),
        _noise(topomap),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def plain(text: object) -> str:
    """Text that markdown shows as it is, on one line, also in a table."""
    line = " ".join(str(text).split())
    return "".join("\\" + c if c in "\\`*_{}[]<>#|~" else c for c in line)


def several(count: int, one: str, many: str = "") -> str:
    """A number and its noun, the number in bold: "**1** run", "**2** runs"."""
    return f"**{count}** {one if count == 1 else many or one + 's'}"


def clock(time_ns: int) -> str:
    """A time in UTC to the second; nanoseconds where no calendar reaches."""
    try:
        return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S}"
    except (OverflowError, ValueError, OSError):
        return f"{time_ns} ns"


def minutes(span_ns: int) -> str:
    """A duration, as one says it."""
    seconds = span_ns / 1e9
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def bulleted(lines: Iterable[str], most: int = MOST_LINES) -> str:
    """A list of markdown, cut after `most` lines with a note of how many are left out."""
    every = list(lines)
    shown = [f"- {line}" for line in every[:most]]
    if len(every) > most:
        shown.append(f"- … and {len(every) - most} more, in the JSON document")
    return "\n".join(shown)


def _counts(topomap: TopoMap) -> str:
    kinds = Counter(topomap.kind)
    named = ", ".join(
        f"{n} {kind.replace('_', ' ')}{'s' * (n != 1)}" for kind, n in sorted(kinds.items())
    )
    unseen = int((~driven_branches(topomap)).sum())
    rows = [
        several(len(topomap), "vertex", "vertices") + (f" ({plain(named)})" if named else ""),
        f"{several(len(topomap.source), 'corridor')}, {topomap.length.sum():.0f} m in all",
        several(len(topomap.observation_vertex), "pass", "passes") + _span(topomap),
        f"{several(unseen, 'branch', 'branches')} seen and never driven",
    ]
    return bulleted(rows)


def _span(topomap: TopoMap) -> str:
    times = topomap.observation_time_ns
    if len(times) == 0:
        return ""
    first, last = int(times.min()), int(times.max())
    return f" in {minutes(last - first)}, from {clock(first)} UTC"


def _legend(topomap: TopoMap) -> str:
    if len(topomap) == 0:
        return "The map is empty: no junction was found in this run."
    return (
        "Junctions are coloured by their branches: dead ends **red**, bends **grey**, three "
        "**blue**, four **green**, more **violet**. **Amber** arrows: branches never driven. "
        "The thin **grey** track: the raw odometry. Corridors are brighter the more often they "
        "were driven.\n\n"
        "Point at a junction or a corridor for what is known about it, or select it and open the "
        "panel on the right; the eye symbols on the left show and hide layers (some start "
        "hidden); the time line below moves the robot."
    )


def _closures(closures: tuple[Closure, ...]) -> str:
    if not closures:
        return ""
    # What was only put off, and answered later, is told by its last answer.
    refused = [c for c in closures if not c.accepted and not c.revised]
    head = f"## Loops\n\n{several(sum(c.accepted for c in closures), 'visit')} recognised"
    if not refused:
        return f"{head}, none refused."
    lines = (
        f"{clock(c.time_a_ns)[-8:]} and {clock(c.time_b_ns)[-8:]} ({c.bits:+.1f} bits): "
        f"{plain(c.reason)}"
        for c in sorted(refused, key=lambda c: (-c.bits, c.time_b_ns, c.time_a_ns))
    )
    return f"{head}, **{len(refused)}** refused:\n\n{bulleted(lines)}"


def _warnings(topomap: TopoMap) -> str:
    warnings = topomap.info.get("warnings") or ()
    if not warnings:
        return ""
    return "## Warnings\n\n" + bulleted(plain(w) for w in warnings)


def _source(topomap: TopoMap) -> str:
    """What the map was made from, as far as its document says it."""
    source = topomap.info.get("source")
    if not isinstance(source, Mapping):
        return ""
    lines = []
    for name, value in sorted(source.items()):
        told = value
        if isinstance(value, Mapping):
            told = ", ".join(f"{v} {k}" if k == "messages" else str(v) for k, v in value.items())
        lines.append(f"{plain(name)}: {plain(told)}")
    return "## Made from\n\n" + bulleted(lines) if lines else ""


def _noise(topomap: TopoMap) -> str:
    n = topomap.noise
    degrees = np.degrees([n.heading_rad_per_sqrt_m, n.branch_rad])
    per_sqrt_degree = np.sqrt(np.degrees(1.0)) * n.heading_rad_per_sqrt_rad
    rows = [
        ("odometry, along", f"{n.along_m_per_sqrt_m:.3f} m/√m"),
        ("odometry, heading", f"{degrees[0]:.2f} °/√m"),
        ("odometry, turning", f"{per_sqrt_degree:.2f} °/√°"),
        ("odometry, scale", f"{100 * n.scale:.2f} %"),
        ("junction centre", f"{n.centre_m:.3f} m"),
        ("branch heading", f"{degrees[1]:.1f} °"),
        ("passes missed", f"{100 * n.miss_rate:.1f} %"),
        ("invented per corridor", f"{100 * n.phantom_rate:.1f} %"),
        ("wrong branches", f"{100 * n.branch_fault_rate:.1f} %"),
    ]
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    return f"## Noise of this run (one sigma)\n\n| what | value |\n| --- | ---: |\n{table}"
