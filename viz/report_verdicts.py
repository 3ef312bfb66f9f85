"""The verdicts of a merge in a report: a matrix, and every pair with its reason."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from ..merge.result import MergeResult, PairVerdict, Standing, shown_bits
from ..topology.wording import counted
from .canvas import legible
from .report_style import text
from .verdicts import LOCKED, numbers_told, strongest

STANDINGS = tuple(map(str, Standing))
TOLD_FIRST = (Standing.AMBIGUOUS, Standing.KEPT_OUT, Standing.MERGED)
"""Standings that are listed first and in full; the others are listed by the script."""

MOST_WRITTEN = 400
"""Longer lists are not written into the page but listed by the script when opened."""

MOST_NAMES = 60
"""Up to this many runs the matrix has their names."""

SQUARE_REM = 5.0
"""Side of a cell of the matrix, if all have room [rem]."""

MOST_NUMBERS = 14
"""Up to this many runs the evidence is written into the matrix."""


def verdict_matrix(result: MergeResult | None, runs: Sequence[str]) -> str:
    """The verdicts of all pairs as coloured cells, runs of a component next to each other."""
    if result is None or len(runs) < 2:
        return ""
    n, row = len(runs), {run: i for i, run in enumerate(runs)}
    drawn, left = _squares(result, row), 0.0
    if n <= MOST_NAMES:
        size = min(0.7, 0.022 * n + 0.12)
        left = 0.6 * size * max(min(len(run), 24) for run in runs) + 0.5
        drawn += [
            _label(-0.2, i + 0.5 + 0.35 * size, run, "end", size=size) for i, run in enumerate(runs)
        ]
    if n <= MOST_NUMBERS:  # last: drawn on top
        drawn += _numbers(result, row)
    count = result.standings()
    legend = "".join(
        f"<span>{_swatch(kind)}{text(kind)}</span>" for kind in Standing if count[kind]
    )
    framed = ", the runs of a site together and framed" if _blocks(result, row) else ""
    numbered = f" {numbers_told(result)}" if n <= MOST_NUMBERS else ""
    return (
        f"<h2>Verdicts</h2><p>Every pair of runs{framed}.{numbered}</p>"
        f'<div class="legend">{legend}</div>'
        f'<div id="matrix" style="max-width:{min(SQUARE_REM * (n + left), 48):.0f}rem">'
        f'<svg viewBox="{-left:.2f} -0.2 {n + left + 0.2:.2f} {n + 0.4:.2f}" role="img" '
        f'aria-label="verdict of every pair">{"".join(drawn)}'
        '<rect id="spot" width="1" height="1" visibility="hidden"/></svg></div>'
        '<p id="told" class="dim" aria-live="polite">Point at a square for the names and the '
        "reason; click to keep it.</p>"
    )


def _squares(result: MergeResult, row: Mapping[str, int]) -> list[str]:
    """The matrix without text: cells of pairs, frames of components."""
    n = len(row)
    cells: dict[Standing, list[str]] = {standing: [] for standing in Standing}
    for pair in result.verdicts:
        i, j = sorted((row[pair.a], row[pair.b]))
        if pair.standing is not Standing.UNRELATED:
            cells[pair.standing] += [f"M{x} {y}h1v1h-1z" for y, x in ((i, j), (j, i))]
    drawn = [f'<rect width="{n}" height="{n}" fill="var(--v{STANDINGS.index("unrelated")})"/>']
    if (
        result.unlisted is not None
    ):  # pairs that are not listed: joined within a component, else unrelated
        blocks = [f"M{k} {k}h{s}v{s}h-{s}z" for k, s in _blocks(result, row)]
        drawn.append(_filled(blocks, f"v{STANDINGS.index('joined through others')}"))
    drawn += [_filled(of, f"v{STANDINGS.index(str(kind))}") for kind, of in cells.items() if of]
    drawn.append(_filled([f"M{k} {k}h1v1h-1z" for k in range(n)], "c3"))
    return drawn + [
        f'<rect class="frame" x="{k}" y="{k}" width="{size}" height="{size}"/>'
        for k, size in _blocks(result, row)
    ]


def _filled(paths: list[str], colour: str) -> str:
    return f'<path d="{"".join(paths)}" fill="var(--{colour})"/>'


def _numbers(result: MergeResult, row: Mapping[str, int]) -> list[str]:
    """The evidence of every pair, above the diagonal, and which of them a person locked."""
    out = []
    for pair in result.verdicts:
        i, j = sorted((row[pair.a], row[pair.b]))
        look = f"s{STANDINGS.index(str(pair.standing))}"
        bits = shown_bits(pair.evidence_bits)
        out.append(_label(j + 0.5, i + 0.6, bits, "middle", size=0.26, look=look))
        if pair.locked:
            out.append(_label(j + 0.5, i + 0.85, LOCKED, "middle", size=0.2, look=look))
    return out


def _blocks(result: MergeResult, row: Mapping[str, int]) -> list[tuple[int, int]]:
    """First row and size of every component of several runs."""
    return [
        (min(row[run] for run in c.poses), len(c.poses))
        for c in result.components
        if len(c.poses) > 1
    ]


def _label(x: float, y: float, words: str, anchor: str, *, size: float, look: str = "") -> str:
    short = words if len(words) <= 24 else f"{words[:12]}…{words[-11:]}"
    place = f'x="{x:.2f}" y="{y:.2f}" font-size="{size:.2f}" text-anchor="{anchor}"'
    return f'<text class="{look}" {place}>{text(short)}</text>'


def pair_lists(result: MergeResult | None) -> str:
    """Every pair with its reason, by standing: TOLD_FIRST in full, the others by the script."""
    if result is None or not result.verdicts:
        return ""
    by: dict[Standing, list[PairVerdict]] = {standing: [] for standing in Standing}
    for pair in strongest(result.verdicts):
        by[pair.standing].append(pair)
    rest = [s for s in Standing if s not in TOLD_FIRST]
    parts = ["<h2>Every pair and its reason</h2>"]
    for standing in (*TOLD_FIRST, *rest):
        if not by[standing]:
            continue
        many = f"{counted(len(by[standing]), 'pair')} {standing}"
        head = f"<summary>{_swatch(standing)}{many}</summary>"
        if standing in TOLD_FIRST and len(by[standing]) <= MOST_WRITTEN:
            lines = "".join(
                f"<li><b>{text(p.a)} + {text(p.b)}</b>{pair_told(p)}</li>" for p in by[standing]
            )
            parts.append(f'<details>{head}<ol class="pairs">{lines}</ol></details>')
        else:
            kind = STANDINGS.index(str(standing))
            parts.append(
                f'<details data-standing="{kind}">{head}<ol class="pairs"></ol>'
                "<noscript>This list takes JavaScript; merged.json holds it as well.</noscript>"
                "</details>"
            )
    unlisted = sum(result.standings().values()) - len(result.verdicts)
    if unlisted:
        parts.append(
            f"<p>{counted(unlisted, 'pair')} more, joined through others or unrelated, that a "
            "large merge only counts; <code>topobatch explain A B</code> matches one anew.</p>"
        )
    return "\n".join(parts)


def _swatch(standing: Standing) -> str:
    return f'<i class="swatch" style="background:var(--v{STANDINGS.index(str(standing))})"></i>'


def pair_told(pair: PairVerdict) -> str:
    """Why the pair was decided so, as HTML paragraphs."""
    lines = [text(pair.reason)]
    for what, alignment in (("it", pair.best), ("the next best placement", pair.runner_up)):
        if alignment is not None:
            lines += [text(f"Against {what}: {c}") for c in alignment.contradictions[:3]]
    if pair.advice:
        lines.append(f"To settle it: {text(pair.advice)}")
    if pair.locked:
        lines.append(f"Decided by a person: {text(pair.locked)}")
    return "".join(f"<p>{line}</p>" for line in lines)


def page_data(result: MergeResult | None, runs: Sequence[str]) -> str:
    """The script's data as JSON without characters that HTML could take as markup."""
    row = {run: i for i, run in enumerate(runs)}
    reasons: dict[str, int] = {}
    pairs = []
    components = () if result is None else result.components
    home = {run: c.id for c in components for run in c.poses}
    for p in strongest(result.verdicts) if result is not None else ():
        i, j = sorted((row[p.a], row[p.b]))
        k = reasons.setdefault(legible(p.reason), len(reasons))
        bits = round(p.evidence_bits, 2) + 0.0
        pairs.append([i, j, STANDINGS.index(str(p.standing)), bits, k])
    doc = {
        "runs": [legible(run) for run in runs],
        "standings": STANDINGS,
        "reasons": list(reasons),
        "pairs": pairs,
        "homes": [home.get(run) for run in runs],
        "counted": result is not None and result.unlisted is not None,
    }
    raw = json.dumps(doc, separators=(",", ":"), ensure_ascii=True)
    return raw.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
