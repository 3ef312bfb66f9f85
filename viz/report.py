"""A merge as a single self-contained HTML page, which answers first and shows the proof below.

The page holds Bokeh's JavaScript, figures as JSON, and one script of ours (`report.js`). A content
security policy allows these two scripts by their digests and nothing else: no request leaves, and
no name from a log can become code.
"""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.models import ColumnDataSource, FixedTicker
from bokeh.resources import Resources
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..merge.change import Change
from ..merge.decision import Decision
from ..merge.drive import Drive
from ..merge.result import Component, MergeResult, Standing, of_sites, shown_bits
from ..topology.arrays import FloatArray, IntArray
from ..topology.made_from import describe_junctions
from ..topology.topomap import TopoMap
from ..topology.wording import counted, legible, listed, to_turning_points, utc
from .pages import minutes
from .palette import LIGHT
from .parts import in_order, ranks, runs_in_order
from .report_maps import INK, blank_figure, described_change, site_map
from .report_pairs import STANDING_COLOURS, matrix_figure, named_axis, page_data, pair_figure
from .sheet import upright_rad

MOST_MAPS = 60
"""Sites that have a map, those of most runs first; a run's own map is there for each."""

SHORTEST = 0.01
"""A run is at least so long in the time line, over the time of all."""

MS_NS = 1_000_000
"""Nanoseconds of a millisecond: a run lasts at least so long."""

MOST_TICKS = 4
"""About so many times stand below the time line, also on a telephone."""


@dataclass(frozen=True, slots=True)
class Report:
    """The contents of a report.

    maps: of every readable run, by name; as_merged: whether they are those that were merged;
    result: the last merge or None; warnings: runs that cannot be read or have changed since the
    merge; locks: decisions by a person, as text; versions: of the program and its libraries;
    drives: what to record next; without any, unexplored: why, and where branches were never driven;
    changes: in all components; decisions: on the pairs whose evidence
    is shown line by line; where: options that name the workspace in a call.
    """

    maps: Mapping[str, TopoMap]
    result: MergeResult | None
    warnings: Sequence[str] = ()
    locks: Sequence[str] = ()
    versions: Sequence[tuple[str, str]] = ()
    drives: Sequence[Drive] = ()
    unexplored: Sequence[str] = ()
    changes: Sequence[Change] = ()
    decisions: Mapping[tuple[str, str], Decision] = field(default_factory=dict)
    where: Sequence[str] = ()
    as_merged: bool = True


def report_page(report: Report) -> str:
    """The HTML page. Its template escapes whatever it is given."""
    result = report.result
    runs = runs_in_order(result) if result is not None else []
    runs += sorted(set(report.maps) - set(runs))
    told = page_data(result, runs, report.maps, report.decisions, report.where)
    items: dict[str, Any] = {"runs": told}
    items |= {name: _item(name, pair_figure()) for name in ("pair-a", "pair-b")}
    sites = _sites(report, items)
    if result is not None and len(runs) > 1:
        items["matrix"] = _item("matrix", matrix_figure(result))
    rows = _time_line(report, runs, items)
    library = Resources(mode="inline", components=["bokeh"]).js_raw[0]
    script = _file("report.js")
    page = _TEMPLATES.get_template("report.html").render(
        title=f"topobatch: {counted(len(runs), 'run')}",
        answer=answer(report, runs),
        warnings=_warnings(report),
        style=_file("report.css"),
        scripts=[library, script],
        digests=[_digest(library), _digest(script)],
        sites=sites,
        drives=[(k, d, shown_bits(d.bits)) for k, d in enumerate(report.drives, 1)],
        unexplored=[line[:1].upper() + line[1:] for line in report.unexplored],
        changes=_changes(report),
        legend=_legend(result),
        need=result and result.threshold_bits and shown_bits(result.threshold_bits),
        runs=runs,
        time_rows=rows,
        timeless=sum(len(m.observation_time_ns) == 0 for m in report.maps.values()),
        health=_health(report, runs),
        locks=report.locks,
        versions=", ".join(f"{name} {version}" for name, version in report.versions),
        items={name: _json(item) for name, item in items.items()},
    )
    return page


def _file(name: str) -> str:
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def _one_line(value: object) -> str:
    """Any value as text on one line, without unprintable characters."""
    return legible(" ".join(str(value).split()))


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters["line"] = _one_line


def _item(name: str, plot: Any) -> Any:
    """A figure as JSON values; its parts are named anew, so that the same figure is the same JSON,
    whatever a process drew before."""
    numbers: dict[str, str] = {}

    def renumbered(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                key: numbers.setdefault(part, f"{name}-{len(numbers)}")
                if key in ("id", "root_id") and isinstance(part, str)
                else renumbered(part)
                for key, part in value.items()
            }
        return [*map(renumbered, value)] if isinstance(value, list) else value

    return renumbered(json_item(plot))


def _digest(script: str) -> str:
    """What a content security policy calls a script by."""
    return "sha256-" + b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _json(value: object) -> str:
    """JSON without characters that HTML could take as markup."""
    raw = json.dumps(value, separators=(",", ":"), ensure_ascii=True)
    return raw.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def _number(count: int) -> str:
    return _NUMBERS[count] if count < len(_NUMBERS) else f"{count:,}"


def answer(report: Report, runs: Sequence[str]) -> list[str]:
    """The sentences that answer: which runs are of which site, which stand alone, what is open, and
    what would settle most."""
    result = report.result
    if result is None:
        return [f"{counted(len(runs), 'run')}, not merged yet: topobatch merge --all."]
    several, alone = _groups(result)
    merged, every = sum(len(c.poses) for c in several), sum(len(c.poses) for c in result.components)
    out = []
    if several:
        names = listed([f"{c.name} ({len(c.poses)})" for c in several], 12)
        all_ = "Both" if every == 2 else f"All {every}"
        all_ = all_ if merged == every else f"{merged} of {every}"
        sites = "one site" if len(several) == 1 else f"{_number(len(several))} sites"
        out.append(f"{all_} runs are of {sites}: {names}.")
    if alone:
        who = listed([c.alone for c in alone], 12)
        stands = "stands" if len(alone) == 1 else "stand"
        out.append(f"{_number(len(alone)).capitalize()} {stands} alone: {who}.")
    if open_ := result.standings()[Standing.AMBIGUOUS]:
        are = "is" if open_ == 1 else "are"
        out.append(f"{counted(open_, 'pair')} of runs {are} open (ambiguous).")
    if report.drives:
        where, settles = report.drives[0].words
        shows = "" if report.drives[0].onto else "shows "
        out.append(f"To record next: {where}; it {shows}{settles}.")
    if sure := sum(c.sure for c in report.changes):
        out.append(f"{counted(sure, 'change')} between runs.")
    return out


def _groups(result: MergeResult) -> tuple[list[Component], list[Component]]:
    """Components of several runs, those of most first, and those of one."""
    ordered = in_order(result)
    several = [c for c in ordered if len(c.poses) > 1]
    return several, sorted(ordered[len(several) :], key=lambda c: c.name)


def _warnings(report: Report) -> list[str]:
    out = [*report.warnings]
    if report.result is not None:
        out += [str(w) for w in report.result.info.get("warnings") or ()]
        home = {run for c in report.result.components for run in c.poses}
        if left := sorted(set(report.maps) - home):
            out.append(f"Not in the last merge: {listed(left)}")
    return out


def _sites(report: Report, items: dict[str, Any]) -> list[dict[str, Any]]:
    """The sites that have a map: those of several runs and those where a drive begins; their
    figures go to `items`."""
    result = report.result
    if result is None:
        return []
    rank = ranks(result)
    begins = {d.component for d in report.drives}
    several, alone = _groups(result)
    shown = [*several, *(c for c in alone if c.id in begins or len(result.components) == 1)]
    out = []
    for c in shown[:MOST_MAPS]:
        name, runs, fused = f"site-{c.id}", sorted(c.poses), of_sites(result, [c.id]).fused
        maps = {run: report.maps[run] for run in runs if report.as_merged and run in report.maps}
        plot = site_map(result, c, maps, report.changes, report.drives)
        items[name] = _item(name, plot)
        wide, high = (r.end - r.start for r in (plot.x_range, plot.y_range))
        ink = [LIGHT.run(rank[run]) if len(runs) > 1 else INK for run in runs]
        out.append(
            {
                "id": c.id,
                "name": c.name,
                "told": f"{counted(len(runs), 'run')}, {counted(fused.junctions, 'junction')}, "
                f"{fused.lengths_m[0]:,.0f} m of corridors{to_turning_points(fused.turned)}",
                "runs": list(zip(runs, ink, strict=True)),
                "shape": round(wide / high, 3),
                "turn": f"{np.degrees(upright_rad(fused.paths)):.0f}",
                "most": int(np.flatnonzero(result.fused.component == c.id).max(initial=0)),
            }
        )
    return out


def _changes(report: Report) -> list[str]:
    """The words of every change."""
    names = {c.id: c.name for c in report.result.components} if report.result else {}
    return [described_change(c, names[c.component]) for c in report.changes if c.sure]


def _legend(result: MergeResult | None) -> list[tuple[str, str, int]]:
    """Colour, name and number of pairs of each standing that there is."""
    count = result.standings() if result else {}
    return [(STANDING_COLOURS[s], str(s), n) for s, n in count.items() if n]


def _time_line(report: Report, runs: Sequence[str], items: dict[str, Any]) -> int:
    """Draw when each run was recorded, a row or more for each site; returns the number of rows."""
    several, _ = _groups(report.result) if report.result is not None else ([], [])
    groups = [(c.name, sorted(c.poses)) for c in several]
    grouped = {run for _, own in groups for run in own}
    groups.append(("alone", [run for run in runs if run not in grouped]))
    spans = {
        run: (int(m.observation_time_ns.min()), int(m.observation_time_ns.max()))
        for run, m in report.maps.items()
        if len(m.observation_time_ns)
    }
    if not spans:
        return 0
    knots, places, ticks = _clock(sorted(spans.values()))
    least = SHORTEST * places[-1]
    free: list[float] = []
    bars: dict[str, list[Any]] = {k: [] for k in ("left", "right", "top", "bottom", "ink", "told")}
    labels: dict[float, str] = {}
    for name, own in groups:
        first = len(free)
        for rank, run in enumerate(own):
            if run not in spans:
                continue
            labels[first + 0.5] = name
            begin, end = spans[run]
            left, right = np.interp(np.subtract((begin, end), knots[0]), knots - knots[0], places)
            right = max(right, left + least)
            row = next((k for k in range(first, len(free)) if free[k] < left), len(free))
            if row == len(free):
                free.append(0.0)
            free[row] = right + least / 4
            bars["left"].append(round(float(left), 2))
            bars["right"].append(round(float(right), 2))
            bars["bottom"].append(row + 0.15)
            bars["top"].append(row + 0.85)
            bars["ink"].append(LIGHT.run(rank) if run in grouped else INK)
            bars["told"].append(legible(f"{run}: {utc(begin)} UTC, {minutes(end - begin)}"))
    spare = places[-1] / 50
    plot = blank_figure((-spare, places[-1] + least + spare), (len(free), 0), "xpan,tap")
    plot.quad(
        "left", "right", "top", "bottom",
        source=ColumnDataSource(bars), fill_color="ink", line_color=None,
        nonselection_fill_alpha=1.0, selection_fill_color="#c026d3",
    )  # fmt: skip
    plot.ygrid[0].update(visible=False)
    plot.xgrid[0].update(grid_line_color=INK, grid_line_alpha=0.25)
    plot.xaxis[0].update(
        major_label_text_color=INK,
        major_label_text_font_size="10px",
        axis_line_color=INK,
        major_tick_line_color=INK,
        minor_tick_line_color=None,
        ticker=FixedTicker(ticks=[*ticks]),
        major_label_overrides=ticks,
    )
    named_axis(plot.yaxis[0], labels)
    items["time"] = _item("time", plot)
    return len(free)


def _clock(spans: Sequence[tuple[int, int]]) -> tuple[IntArray, FloatArray, dict[float, str]]:
    """The axis of the time line: times (k,) [ns] and their places on it [s], between which it is
    linear; and the texts of its ticks. spans: of the runs, by time.

    Gaps between recordings are shortened to the mean time recorded between two of them, so that
    years without any take no more room than the runs.
    """
    whole: list[list[int]] = []
    for begin, end in spans:
        if whole and begin <= whole[-1][1]:
            whole[-1][1] = max(end, whole[-1][1])
        else:
            whole.append([begin, max(end, begin + MS_NS)])
    knots = np.array(whole).ravel()
    step = np.diff(knots, prepend=knots[0]) / 1e9
    recorded, gaps = step[1::2], step[2::2]
    gaps[:] = np.minimum(gaps, recorded.mean())
    places = np.cumsum(step)
    at = places[::2] if len(whole) > 1 else np.linspace(0.0, places[-1], MOST_TICKS)
    times = np.interp(at, places, knots - knots[0])
    ticks: dict[float, str] = {}
    for x, time in zip(at.tolist(), times.tolist(), strict=True):
        if not ticks or x - max(ticks) >= places[-1] / MOST_TICKS:
            ticks[round(x, 2)] = utc(int(time) + int(knots[0]), "%Y-%m-%d %H:%M")
    return knots, places, ticks


def _health(report: Report, runs: Sequence[str]) -> list[tuple[list[str], list[str]]]:
    """For each run the cells of its row, and what is said below it."""
    home: dict[str, str] = {}
    if report.result is not None:
        home = {run: c.name for c in report.result.components for run in c.poses}
    out = []
    for run in runs:
        if run in report.maps:
            m = report.maps[run]
            source = describe_junctions(m.info)
            told = ([source] if source else []) + [str(w) for w in m.info.get("warnings") or ()][:8]
            out.append(([run, home.get(run, "—"), *_measured(m)], told))
    return out


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
