"""What a merge says of every pair of runs: as a matrix, and in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..merge.result import Alignment, MergeResult, PairVerdict, Standing, shown_bits
from .map_summary import bulleted, plain, several
from .steps import Step

DIAGONAL, UNRELATED, AMBIGUOUS, NOT_ACCEPTED, JOINED, MERGED = range(6)
"""Classes of the verdict matrix. NOT_ACCEPTED: the pair fits, but a later check kept it out;
JOINED: unrelated by itself, but other runs place the two in one component."""

MOST_PAIRS = 60
"""Pairs told in full in the recording; `merged.json` has them all."""

STORY_BEFORE, STORY_AFTER = 8, 12
"""Steps that a page of the story shows around its own."""

_CLASSES = {
    Standing.UNRELATED: UNRELATED,
    Standing.AMBIGUOUS: AMBIGUOUS,
    Standing.KEPT_OUT: NOT_ACCEPTED,
    Standing.JOINED: JOINED,
    Standing.MERGED: MERGED,
}


def runs_in_order(result: MergeResult) -> list[str]:
    """All runs: those of one component together, large components first."""
    components = sorted(result.components, key=lambda c: (-len(c.poses), c.id))
    return [run for component in components for run in sorted(component.poses)]


def verdict_class(pair: PairVerdict) -> int:
    """The class of a pair in the matrix."""
    return _CLASSES[pair.standing]


def verdict_matrix(result: MergeResult, runs: Sequence[str]) -> NDArray[np.uint8]:
    """(n, n) classes of all pairs, symmetric, rows and columns in the given order."""
    row = {run: i for i, run in enumerate(runs)}
    matrix = np.full((len(runs), len(runs)), UNRELATED, np.uint8)
    if result.unlisted is not None:
        for component in result.components:  # what is not listed is joined, or unrelated
            rows = [row[run] for run in component.poses if run in row]
            matrix[np.ix_(rows, rows)] = JOINED
    np.fill_diagonal(matrix, DIAGONAL)
    for pair in result.verdicts:
        if pair.a in row and pair.b in row:
            i, j = row[pair.a], row[pair.b]
            matrix[i, j] = matrix[j, i] = verdict_class(pair)
    return matrix


def merge_summary(result: MergeResult) -> str:
    """A page of markdown: counts, components, how to read the picture, warnings."""
    count = {kind: result.count(standing) for standing, kind in _CLASSES.items()}
    fused = result.fused
    shared = sum(len(members) > 1 for members in fused.members)
    runs = sum(len(c.poses) for c in result.components)
    kept_out = f", **{count[NOT_ACCEPTED]}** kept out" if count[NOT_ACCEPTED] else ""
    joined = f"**{count[JOINED]}** joined through others, " if count[JOINED] else ""
    rows = [
        f"{several(runs, 'run')} in {several(len(result.components), 'component')}",
        f"{several(len(fused), 'junction')}, {shared} of them seen by several runs",
        f"{several(len(fused.source), 'corridor')}, {float(fused.length.sum()):.0f} m in all",
        f"pairs of runs: **{count[MERGED]}** merged, {joined}**{count[AMBIGUOUS]}** ambiguous, "
        f"**{count[UNRELATED]}** unrelated{kept_out}",
    ]
    if "method" in result.info:
        rows.append(f"method: {plain(result.info['method'])}")
    need = next((p.threshold_bits for p in result.verdicts if p.threshold_bits is not None), None)
    needed = "" if need is None else f" Merging needs {need:.1f}."
    legend = f"{_LEGEND}{needed}"
    parts = ["# Merged map", bulleted(rows), _components(result), legend, _notes(result)]
    return "\n\n".join(part for part in parts if part) + "\n"


_LEGEND = """## How to read it

**Map**: every corridor is a ribbon with one strand for each run that drove it; junctions seen by \
several runs are white, others grey. **Agreement**: the brighter, the more runs. **Runs**: each \
run's own map, laid into its component. **Step by step**: move the *join* time line to see the \
runs come together, strongest evidence first. **Undecided**, where there are any: both \
placements of every pair that the evidence does not decide.

Point at anything for what is known about it, or select it and open the panel on the right; the \
eye symbols on the left show and hide runs. In the matrix green pairs are merged, dark green \
ones joined through other runs, orange ones ambiguous; the numbers are bits of evidence."""


def _components(result: MergeResult) -> str:
    size = Counter(result.fused.component.tolist())
    order = sorted(result.components, key=lambda c: (-len(c.poses), c.id))
    lines = [
        f"component {c.id}: {size[c.id]} junctions from "
        + (
            f"{len(c.poses)} runs ({_listed(sorted(c.poses))})"
            if len(c.poses) > 1
            else plain(*c.poses)
        )
        for c in order
    ]
    return "## Components\n\n" + bulleted(lines) if lines else "There are no runs to merge."


def _listed(names: Sequence[str], most: int = 12) -> str:
    shown = ", ".join(plain(name) for name in names[:most])
    return shown if len(names) <= most else f"{shown}, … {len(names) - most} more"


def _notes(result: MergeResult) -> str:
    warnings = result.info.get("warnings") or ()
    return "## Warnings\n\n" + bulleted(plain(w) for w in warnings) if warnings else ""


def pairs_told(result: MergeResult) -> str:
    """Markdown with every pair's verdict, reason and evidence; the strongest of each kind first."""
    parts = ["# Pairs of runs"]
    for standing, title in (
        (Standing.AMBIGUOUS, "Ambiguous"),
        (Standing.KEPT_OUT, "Fitting, but kept out"),
        (Standing.MERGED, "Merged"),
        (Standing.JOINED, "Joined through others"),
        (Standing.UNRELATED, "Unrelated"),
    ):
        kind = _CLASSES[standing]
        pairs = strongest(p for p in result.verdicts if verdict_class(p) == kind)
        everyone = result.count(standing)
        if everyone:
            parts.append(f"## {title} ({everyone})")
            told = _in_short if kind in (JOINED, UNRELATED) else _in_full
            parts.append("\n".join(told(pair) for pair in pairs[:MOST_PAIRS]))
            if len(pairs) > MOST_PAIRS:
                parts.append(f"… and {len(pairs) - MOST_PAIRS} more, in `merged.json`")
            if everyone > len(pairs):
                parts.append(f"{everyone - len(pairs)} pairs that a large merge only counts")
    if len(parts) == 1:
        parts.append("There is no pair: fewer than two runs.")
    return "\n\n".join(parts) + "\n"


def strongest(pairs: Iterable[PairVerdict]) -> list[PairVerdict]:
    """Pairs in descending order of evidence, then by name."""
    return sorted(pairs, key=lambda p: (-p.evidence_bits, p.a, p.b))


def _in_short(pair: PairVerdict) -> str:
    return f"- {plain(pair.a)} - {plain(pair.b)}: {plain(pair.reason)}"


def _in_full(pair: PairVerdict) -> str:
    lines = [f"**{plain(pair.a)} - {plain(pair.b)}**: {plain(pair.reason)}"]
    if pair.best is not None:
        lines.append(f"best: {shown_bits(pair.best.evidence_bits)} bits, {_placement(pair.best)}")
    if pair.runner_up is not None:
        bits = f"{shown_bits(pair.runner_up.evidence_bits)} bits"
        if pair.margin_bits is not None:
            bits = f"{bits}, {shown_bits(pair.margin_bits)} behind"
        lines.append(f"runner-up: {bits}, {_placement(pair.runner_up)}")
    if pair.advice:
        lines.append(f"to settle it: {plain(pair.advice)}")
    if pair.locked:
        lines.append(f"decided by a person: {plain(pair.locked)}")
    head, *rest = lines
    return "\n".join([f"- {head}", *(f"  - {line}" for line in rest)])


def _placement(a: Alignment) -> str:
    x, y, theta = a.transform
    told = (
        f"{len(a.matched)} junctions and {a.corridors} corridors "
        f"matched, {a.rmse_m:.2f} m apart on average, at ({x:.2f}, {y:.2f}) m, "
        f"{np.degrees(theta):.1f}°"
    )
    against = "; ".join(plain(c) for c in a.contradictions[:3])
    return f"{told}; against it: {against}" if against else told


def joining_told(steps: Sequence[Step]) -> list[str]:
    """A page of markdown for every step, that of step 0 first: what happens there, and around it.

    A page shows STORY_BEFORE steps before its own and STORY_AFTER after it.
    """
    lines = [
        f"**{plain(' and '.join(step.runs))}** "
        f"{'join' if len(step.runs) > 1 else 'joins'} component {step.component}"
        for step in steps
    ]
    reasons = [f"{plain(s.pair.a)} - {plain(s.pair.b)}: {plain(s.pair.reason)}" for s in steps]
    pages = []
    for now in range(len(steps) + 1):
        head = f"# Step {now} of {len(steps)}\n\n"
        head += f"{lines[now - 1]}\n\n{reasons[now - 1]}" if now else "Every run is by itself."
        shown = range(max(0, now - 1 - STORY_BEFORE), min(len(steps), now + STORY_AFTER))
        rest = [f"- {'→ ' if i + 1 == now else ''}{i + 1}: {lines[i]}" for i in shown]
        pages.append(head + "\n\n## Before and after\n\n" + "\n".join(rest) + "\n")
    return pages
