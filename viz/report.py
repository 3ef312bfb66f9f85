"""A merge as a single self-contained HTML page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from ..merge.drive import Drive
from ..merge.result import MergeResult, PairVerdict, Standing, of_site, shown_bits
from ..topology.made_from import junctions_told
from ..topology.topomap import TopoMap
from ..topology.wording import counted, listed, utc
from .canvas import Canvas, legible
from .draw import draw_drive, draw_map, draw_merged, draw_placements
from .map_summary import minutes
from .report_style import script, style_sheet, text
from .report_verdicts import page_data, pair_lists, pair_told, verdict_matrix
from .theme import SWITCHABLE
from .verdicts import MOST_PLACEMENTS, runs_in_order, undecided

MOST_MAPS = 24
"""Up to this many runs, each run's own map is drawn."""

LARGE_PT = 900.0
"""Wider drawings may exceed the width of the text."""


@dataclass(frozen=True, slots=True)
class Report:
    """The contents of a report.

    maps: of every readable run, by name; result: the last merge or None; warnings: runs that cannot
    be read or have changed since the merge; locks: decisions by a person, as text; versions: of the
    program and its libraries; drives: what to record next.
    """

    maps: Mapping[str, TopoMap]
    result: MergeResult | None
    warnings: Sequence[str] = ()
    locks: Sequence[str] = ()
    versions: Sequence[tuple[str, str]] = ()
    drives: Sequence[Drive] = ()


def report_page(report: Report) -> str:
    """The HTML page. Names and reasons are escaped."""
    result = report.result
    runs = runs_in_order(result) if result is not None else []
    runs += sorted(set(report.maps) - set(runs))
    most = max([2, *(len(c.poses) for c in (result.components if result is not None else ()))])
    parts = [
        _head(report, runs),
        _pictures(report),
        _drives(report),
        verdict_matrix(result, runs),
        pair_lists(result),
        _health(report, runs),
        _settings(report),
        _versions(report),
    ]
    body = "\n".join(part for part in parts if part)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:\">"
        '<link rel="icon" href="data:,">'
        f"<title>{_title(report, runs)}</title><style>{style_sheet(most)}</style></head>\n"
        f"<body><main>\n{body}\n</main>\n"
        f'<script type="application/json" id="data">{page_data(result, runs)}</script>\n'
        f"<script>{script()}</script></body></html>\n"
    )


def _title(report: Report, runs: Sequence[str]) -> str:
    merged = "" if report.result is not None else ", not merged yet"
    return f"topobatch: {counted(len(runs), 'run')}{merged}"


def _head(report: Report, runs: Sequence[str]) -> str:
    result = report.result
    facts = [(len(runs), "run", "runs")]
    if result is not None:
        shared = sum(len(m) > 1 for m in result.fused.members[: result.fused.junctions])
        corridors_m, ways_m = map(round, result.fused.lengths_m)
        facts += [
            (len(result.components), "site", "sites"),
            (result.fused.junctions, "junction", "junctions"),
            (shared, "seen by several runs", "seen by several runs"),
            (corridors_m, "m of corridors", "m of corridors"),
        ]
        if result.fused.turned:
            beside = "m to turning points or ends of logs"
            facts.append((ways_m, beside, beside))
        for standing, count in result.standings().items():
            if count or standing in (Standing.MERGED, Standing.AMBIGUOUS):
                words = (f"pair {standing}", f"pairs {standing}")
                facts.append((count, *words))
    boxes = "".join(
        f"<li><b>{number:,}</b>{text(one if number == 1 else many)}</li>"
        for number, one, many in facts
    )
    warnings = [*report.warnings]
    if result is None:
        warnings.append("The runs are not merged yet: topobatch merge --all")
    else:
        warnings += [str(w) for w in result.info.get("warnings") or ()]
        left_out = sorted(set(report.maps) - {run for c in result.components for run in c.poses})
        if left_out:
            warnings.append(f"Not in the last merge: {listed(left_out)}")
    told = "".join(f'<p class="warning">{text(w)}</p>' for w in warnings)
    need = result.threshold_bits if result is not None else None
    how = f"Merging two runs takes {shown_bits(need)} bits of evidence." if need is not None else ""
    explained = (
        f"<p>{text(how)} Each bit doubles the odds that so much agrees because it is one place. "
        "Where evidence falls short, runs stay apart.</p>"
        if how
        else ""
    )
    return (
        f"<header><h1>{_title(report, runs)}</h1>"
        '<button id="theme" type="button">light / dark</button></header>'
        f'<ul class="facts">{boxes}</ul>{told}{explained}'
    )


def _figure(canvas: Canvas, about: str) -> str:
    """A drawing inline; about: its accessible label."""
    svg = canvas.as_bytes("svg").decode()
    large = ' class="large"' if canvas.width_pt > LARGE_PT else ""
    drawn = svg[svg.index("<svg") :].strip()
    return f'<figure{large} role="img" aria-label="{text(about)}">{drawn}</figure>'


def _pictures(report: Report) -> str:
    if report.result is None:
        return ""
    parts = [
        "<h2>Map</h2><p>Each corridor has a strand for every run that drove it; point at one to "
        "see whose it is.</p>",
        _figure(draw_merged(report.result, SWITCHABLE, headed=False), "merged map"),
    ]
    open_pairs = [p for p in undecided(report.result) if _can_be_drawn(p, report.maps)]
    drawn = open_pairs[:MOST_PLACEMENTS]
    if drawn:
        some = len(drawn) < len(open_pairs)
        shown = f"; the {len(drawn)} with the most are shown" if some else ""
        parts.append(
            f"<h2>Undecided: both placements</h2><p>{counted(len(open_pairs), 'pair')} of runs "
            f"may share places, and the evidence does not decide it{shown}.</p>"
        )
    for k, pair in enumerate(drawn):
        canvas = draw_placements(
            report.maps[pair.a], report.maps[pair.b], pair, SWITCHABLE, name=f"pair{k}"
        )
        about = f"{pair.a} + {pair.b}: {shown_bits(pair.evidence_bits)} bits"
        opened = " open" if k == 0 else ""
        parts.append(
            f"<details{opened}><summary>{text(about)}</summary><div>{pair_told(pair)}</div>"
            f"{_figure(canvas, about)}</details>"
        )
    return "\n".join(parts)


def _drives(report: Report) -> str:
    """What to record next: a table, and a picture of each drive."""
    if report.result is None or not report.drives:
        return ""
    rows, pictures = [], []
    for k, drive in enumerate(report.drives, 1):
        where, settles = drive.words
        cells = (k, where, settles, shown_bits(drive.bits), f"{drive.bits_per_m:.3f}")
        rows.append(f"<tr>{''.join(f'<td>{text(c)}</td>' for c in cells)}</tr>")
        site = of_site(report.result, drive.component)
        drawn = draw_drive(site, drive, SWITCHABLE, name=f"drive{k}")
        opened = " open" if k == 1 else ""
        pictures.append(
            f"<details{opened}><summary>{text(f'{k}: {where}')}</summary>"
            f"<p>{text(drive.way)}</p>{_figure(drawn, where)}</details>"
        )
    head = ("", "drive", "would settle", "bits", "bits per metre")
    header = "".join(f"<th>{text(h)}</th>" for h in head)
    return (
        "<h2>What to record next</h2><p>Drives by the evidence that they are expected to bring for "
        "each metre. Their waypoints: topobatch next --output plan.csv</p>"
        f'<div class="wide"><table><thead><tr>{header}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>{''.join(pictures)}"
    )


def _can_be_drawn(pair: PairVerdict, maps: Mapping[str, TopoMap]) -> bool:
    """Whether both maps are there and hold the vertices that the verdict names."""
    if pair.a not in maps or pair.b not in maps:
        return False
    sizes = np.array([len(maps[pair.a]), len(maps[pair.b])])
    placed = [x for x in (pair.best, pair.runner_up) if x is not None]
    named = [np.array([(max(a), max(b))]) for x in placed for a, b in x.contradicting if a and b]
    return all(np.all((n >= 0) & (n < sizes)) for n in (*(x.matched for x in placed), *named))


def _health(report: Report, runs: Sequence[str]) -> str:
    """A table with a row for each run: its contents, its noise and its warnings."""
    home: dict[str, str] = {}
    if report.result is not None:
        home = {run: c.name for c in report.result.components for run in c.poses}
    head = (
        "run",
        "site",
        "first pass (UTC)",
        "lasts",
        "passes",
        "junctions",
        "corridors",
        "closures",
        "refused",
        "heading noise",
        "missed",
        "wrong branches",
        "jumps",
    )
    rows = []
    for run in runs:
        if run in report.maps:
            m = report.maps[run]
            cells = [run, home.get(run, "—"), *_measured(m)]
            source = junctions_told(m.info)
            warned = [str(w) for w in m.info.get("warnings") or ()]
            rows.append(f"<tr>{''.join(f'<td>{text(c)}</td>' for c in cells)}</tr>")
            told = "<br>".join(text(w) for w in ([source] if source else []) + warned[:8])
            rows += [f'<tr><td class="told" colspan="{len(head)}">{told}</td></tr>'] if told else []
    if not rows:
        return ""
    header = "".join(f"<th>{text(h)}</th>" for h in head)
    table = (
        f'<div class="wide"><table><thead><tr>{header}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )
    note = (
        '<p class="dim">A run lasts from its first pass of a junction to its last. Closures: '
        "visits recognised as the same place; refused: visits that were not taken for it. Heading "
        "noise: random walk of the odometry's heading, 1 sigma after a metre. Missed: share of "
        "passes in which a junction went unseen; wrong branches: in which it was seen with one too "
        "many or too few. Jumps: steps of unknown size in the odometry.</p>"
    )
    return f"<h2>Runs</h2>{note}{table}{_own_maps(report, runs)}"


def _measured(m: TopoMap) -> list[str]:
    times, noise = m.observation_time_ns, m.measured
    begin = utc(int(times.min())) if len(times) else "—"
    lasts = minutes(int(times.max() - times.min())) if len(times) else "—"
    accepted = sum(c.accepted for c in m.closures)
    refused = sum(not c.accepted and not c.revised for c in m.closures)
    jumps = m.info.get("jumps")
    return [
        begin,
        lasts,
        f"{len(times):,}",
        f"{len(m):,}",
        f"{len(m.source):,} ({float(m.length.sum()):,.0f} m)",
        f"{accepted:,}",
        f"{refused:,}",
        f"{np.degrees(noise.heading_rad_per_sqrt_m):.2f}°/√m",
        f"{100 * noise.miss_rate:.1f} %",
        f"{100 * noise.branch_fault_rate:.1f} %",
        str(len(jumps)) if isinstance(jumps, Sequence) else "0",
    ]


def _own_maps(report: Report, runs: Sequence[str]) -> str:
    shown = [run for run in runs if run in report.maps]
    if len(shown) > MOST_MAPS:
        return '<p class="dim">A run\'s own map: topobatch draw RUN map.svg</p>'
    return "".join(
        f"<details><summary>Map of {text(run)}</summary>"
        f"{_figure(draw_map(report.maps[run], SWITCHABLE, name=f'own{k}'), f'map of {run}')}"
        "</details>"
        for k, run in enumerate(shown)
    )


def _settings(report: Report) -> str:
    parts = []
    if report.result is not None:
        method = report.result.info.get("method", "unknown")
        parts.append(_folded(f"Merge: method {method}", report.result.info.get("settings") or {}))
    by: dict[str, list[str]] = {}
    for run, m in sorted(report.maps.items()):
        settings = json.dumps(m.info.get("settings") or {}, sort_keys=True)
        by.setdefault(settings, []).append(run)
    for settings, named in sorted(by.items(), key=lambda entry: (-len(entry[1]), entry[1])):
        who = "every run" if len(by) == 1 else listed(named, 6)
        parts.append(_folded(f"Ingest of {who}", json.loads(settings)))
    locks = "".join(f"<li>{text(lock)}</li>" for lock in report.locks)
    told = f"<h3>Locks set by a person</h3><ul>{locks}</ul>" if locks else ""
    return f"<h2>Settings</h2>{''.join(parts)}{told}"


def _folded(title: str, settings: object) -> str:
    shown = json.dumps(settings, indent=1, sort_keys=True, ensure_ascii=False)
    lines = "\n".join(escape(legible(line)) for line in shown.split("\n"))
    return f"<details><summary>{text(title)}</summary><pre>{lines}</pre></details>"


def _versions(report: Report) -> str:
    if not report.versions:
        return ""
    told = ", ".join(text(f"{name} {version}") for name, version in report.versions)
    return f"<h2>Versions</h2><p>{told}</p>"
