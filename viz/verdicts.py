"""A merge's verdicts on all pairs of runs as a matrix, and a summary of a merge."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..merge.result import MergeResult, PairVerdict, Standing, shown_bits
from ..topology.wording import counted, listed, to_turning_points
from .map_summary import bulleted, plain, several

DIAGONAL = 0
CLASS = {standing: k for k, standing in enumerate(Standing, start=DIAGONAL + 1)}
"""Class of each standing in the verdict matrix."""


def runs_in_order(result: MergeResult) -> list[str]:
    """All runs by component, components of most runs first."""
    components = sorted(result.components, key=lambda c: (-len(c.poses), c.id))
    return [run for component in components for run in sorted(component.poses)]


def verdict_matrix(result: MergeResult, runs: Sequence[str]) -> NDArray[np.uint8]:
    """(n, n) classes of all pairs, symmetric, rows and columns in the given order."""
    row = {run: i for i, run in enumerate(runs)}
    matrix = np.full((len(runs), len(runs)), CLASS[Standing.UNRELATED], np.uint8)
    if result.unlisted is not None:
        for component in result.components:  # pairs that are not listed
            rows = [row[run] for run in component.poses if run in row]
            matrix[np.ix_(rows, rows)] = CLASS[Standing.JOINED]
    np.fill_diagonal(matrix, DIAGONAL)
    for pair in result.verdicts:
        if pair.a in row and pair.b in row:
            i, j = row[pair.a], row[pair.b]
            matrix[i, j] = matrix[j, i] = CLASS[pair.standing]
    return matrix


LEGEND = """\
## How to read it

**Map**: every corridor is a ribbon with one strand for each run that drove it, in the colour that
its name has beside *Verdicts*; junctions seen by several runs are white, others grey. **Red** dots:
where joined runs contradict each other. Under the map: what the lasers of all runs saw, walls
**slate**, free space a little brighter than what is not known. Short strokes: branches that nobody
drove. **Runs**: each run's own map, laid into its component.

**Verdicts**, a square for every pair of runs: **green** merged, **dark green** joined through
other runs, **orange** ambiguous, **red** fitting, but kept out by a later check, **grey**
unrelated; the diagonal is dark. The larger the dot, the more evidence; point at it for the bits,
the reason and what would settle it.

Point at anything for what is known about it, or select it and open the panels at the top right;
the left one shows and hides runs."""


def merge_summary(result: MergeResult) -> str:
    """A Markdown page: counts, legend, components, warnings."""
    count = result.standings()
    fused = result.fused
    corridors_m, ways_m = fused.lengths_m
    shared = sum(len(members) > 1 for members in fused.members[: fused.junctions])
    runs = sum(len(c.poses) for c in result.components)
    out, others = count[Standing.KEPT_OUT], count[Standing.JOINED]
    kept_out = f", **{out:,}** kept out" if out else ""
    joined = f"**{others:,}** joined through others, " if others else ""
    rows = [
        f"{several(runs, 'run')} of {several(len(result.components), 'site')}",
        f"{several(fused.junctions, 'junction')}, {shared:,} of them seen by several runs",
        f"{several(fused.corridors, 'corridor')}, {corridors_m:,.0f} m"
        f"{to_turning_points(fused.turned, ways_m)}",
        f"pairs of runs: **{count[Standing.MERGED]:,}** merged, {joined}"
        f"**{count[Standing.AMBIGUOUS]:,}** ambiguous, "
        f"**{count[Standing.UNRELATED]:,}** unrelated{kept_out}",
    ]
    if "method" in result.info:
        rows.append(f"method: {plain(result.info['method'])}")
    if result.threshold_bits is not None:
        rows.append(f"merging needs **{shown_bits(result.threshold_bits)}** bits")
    parts = ["# Merged map", bulleted(rows), LEGEND, _components(result), _notes(result)]
    return "\n\n".join(part for part in parts if part) + "\n"


LOCKED = "locked"
"""Stands beside the evidence of pairs on which a person decided."""


def _components(result: MergeResult) -> str:
    size = Counter(result.fused.component[: result.fused.junctions].tolist())
    order = sorted(result.components, key=lambda c: (-len(c.poses), c.id))
    lines = [
        f"{plain(c.name)}: {counted(size[c.id], 'junction')} from "
        + (
            f"{counted(len(c.poses), 'run')} ({listed([plain(run) for run in sorted(c.poses)])})"
            if len(c.poses) > 1
            else plain(*c.poses)
        )
        for c in order
    ]
    return "## Sites\n\n" + bulleted(lines) if lines else "There are no runs to merge."


def _notes(result: MergeResult) -> str:
    warnings = result.info.get("warnings") or ()
    return "## Warnings\n\n" + bulleted(plain(w) for w in warnings) if warnings else ""


def strongest(pairs: Iterable[PairVerdict]) -> list[PairVerdict]:
    """Pairs in descending order of evidence, then by name."""
    return sorted(pairs, key=lambda p: (-p.evidence_bits, p.a, p.b))
