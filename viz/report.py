"""A merge as a single self-contained HTML page, which answers first and shows the proof below.

The page holds Bokeh's JavaScript, figures as JSON, and one script of ours (`report.js`). A content
security policy allows these two scripts by their digests and nothing else: no request leaves, and
no name from a log can become code.
"""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.resources import Resources
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..merge.change import Change, numbered
from ..merge.decision import Decision
from ..merge.decision_text import weakest_links
from ..merge.drive import Drive
from ..merge.result import Component, MergeResult, Standing, of_sites, shown_bits
from ..topology.driven_branches import driven_branches
from ..topology.made_from import describe_junctions
from ..topology.topomap import TopoMap
from ..topology.wording import counted, legible, listed, to_turning_points, utc
from .pages import minutes
from .palette import BOTH
from .parts import colours_of, in_order, runs_in_order
from .report_maps import site_map
from .report_pairs import STANDING_COLOURS, matrix_figure, page_data, pair_figure
from .report_time import time_line
from .scene import describe_change
from .sheet import upright_rad

MOST_MAPS = 60
"""Sites that have a map, those of most runs first; a run's own map is there for each."""


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
    result, runs = report.result, _ordered_runs(report)
    sites = _sites(report)
    figures = {"pair-a": pair_figure(), "pair-b": pair_figure()}
    figures |= {f"site-{site['id']}": site["figure"] for site in sites}
    if result is not None and len(runs) > 1:
        figures["matrix"] = matrix_figure(result)
    given = (result, runs, report.maps, report.decisions, report.where)
    items = {"runs": page_data(*given, as_merged=report.as_merged)}
    items |= {name: dict(json_item(figure)) for name, figure in figures.items()}
    colours = dict.fromkeys(runs, BOTH["single"])
    if result is not None:
        colours |= colours_of(result, BOTH)
    counts = {} if result is None else result.standings()
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
        legend=[(STANDING_COLOURS[s], str(s), n) for s, n in counts.items() if n],
        need=result and result.threshold_bits and shown_bits(result.threshold_bits),
        runs=runs,
        time=time_line(runs, report.maps, colours),
        timeless=sum(not m.is_driven for m in report.maps.values()),
        health=_health(report, runs),
        locks=report.locks,
        versions=", ".join(f"{name} {version}" for name, version in report.versions),
        items=items,
    )
    return page


def _ordered_runs(report: Report) -> list[str]:
    """All runs: those that were merged, by site, then the others."""
    merged = [] if report.result is None else runs_in_order(report.result)
    return merged + sorted(set(report.maps) - set(merged))


def _file(name: str) -> str:
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters["line"] = lambda value: legible(" ".join(str(value).split()))
_TEMPLATES.policies["json.dumps_kwargs"] = {"separators": (",", ":")}


def _digest(script: str) -> str:
    """What a content security policy calls a script by."""
    return "sha256-" + b64encode(hashlib.sha256(script.encode()).digest()).decode()


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
        out.append(f"{all_} runs are of {counted(len(several), 'site')}: {names}.")
    if alone:
        who = listed([c.alone for c in alone], 12)
        out.append(f"{counted(len(alone), 'run stands', 'runs stand')} alone: {who}.")
    if open_ := result.standings()[Standing.AMBIGUOUS]:
        out.append(f"{counted(open_, 'pair of runs is', 'pairs of runs are')} open (ambiguous).")
    if report.drives:
        where, settles = report.drives[0].words
        shows = "" if report.drives[0].onto else "shows "
        out.append(f"To record next: {where}; it {shows}{settles}.")
    if sure := sum(c.sure for c in report.changes):
        out.append(f"{counted(sure, 'change')} between runs.")
    return out


def _groups(result: MergeResult) -> tuple[list[Component], list[Component]]:
    """Components of several runs, and those of one."""
    ordered = in_order(result)
    several = [c for c in ordered if len(c.poses) > 1]
    return several, ordered[len(several) :]


def _warnings(report: Report) -> list[str]:
    """Warnings of the report, of the merge, and of runs that it left out."""
    out = [*report.warnings]
    if report.result is not None:
        out += [str(w) for w in report.result.info.get("warnings") or ()]
        if left := sorted(report.maps.keys() - report.result.home.keys()):
            out.append(f"Not in the last merge: {listed(left)}")
    return out


def _sites(report: Report) -> list[dict[str, Any]]:
    """The sites that have a map, each with its figure: those of several runs, and where a drive
    begins; without any drive all, as branches that nobody drove are listed by their numbers."""
    result = report.result
    if result is None:
        return []
    begins = {d.component for d in report.drives}
    listed_all = bool(report.unexplored) or len(result.components) == 1
    weakest = weakest_links(result.verdicts, result.home)
    several, alone = _groups(result)
    shown = [*several, *(c for c in alone if c.id in begins or listed_all)]
    largest = sorted(shown, key=lambda c: -len(c.poses))[:MOST_MAPS]
    sure, undriven, out = _sure_changes(report), ~driven_branches(result.fused), []
    for c in (c for c in shown if c in largest):
        runs, fused = sorted(c.poses), of_sites(result, [c.id]).fused
        maps = {run: report.maps[run] for run in runs if report.as_merged and run in report.maps}
        plot = site_map(result, c, maps, changes=sure, drives=report.drives, undriven=undriven)
        wide, high = (r.end - r.start for r in (plot.x_range, plot.y_range))
        out.append(
            {
                "id": c.id,
                "name": c.name,
                "figure": plot,
                "summary": f"{counted(len(runs), 'run')}, {counted(fused.junctions, 'junction')}, "
                f"{fused.lengths_m[0]:,.0f} m of corridors{to_turning_points(fused.turned)}"
                f"{legible(weakest.get(c.id, ''))}",
                "shape": round(wide / high, 3),
                "turn": round(float(np.degrees(upright_rad(fused.paths)))),
                "most": int(np.flatnonzero(result.fused.component == c.id).max(initial=0)),
            }
        )
    return out


def _sure_changes(report: Report) -> list[Change]:
    """The changes that are shown, in the order of the sites, as `topobatch changes` has them."""
    order = [] if report.result is None else [c.id for c in in_order(report.result)]
    return sorted((c for c in report.changes if c.sure), key=lambda c: order.index(c.component))


def _changes(report: Report) -> list[tuple[str, list[tuple[int, str]]]]:
    """The changes of every site of several runs that tell times, with their numbers."""
    if report.result is None or not report.as_merged:
        return []
    timed = {run for run, m in report.maps.items() if m.is_driven}
    sure = numbered(_sure_changes(report))
    return [
        (own.name, [(k, describe_change(c, own.name)) for k, c in sure if c.component == own.id])
        for own in _groups(report.result)[0]
        if len(timed & own.poses.keys()) > 1
    ]


def _health(report: Report, runs: Sequence[str]) -> list[tuple[list[str], list[str]]]:
    """For each run the cells of its row, and what is said below it."""
    home = {} if report.result is None else report.result.component_of
    out = []
    for run in runs:
        if run in report.maps:
            m = report.maps[run]
            source = describe_junctions(m.info)
            warnings = [str(w) for w in m.info.get("warnings") or ()][:8]
            site = home[run].name if run in home else "—"
            out.append(([run, site, *_measured(m)], ([source] if source else []) + warnings))
    return out


def _measured(m: TopoMap) -> list[str]:
    """The cells of a run's row that its map fills."""
    times, noise = m.observation_time_ns, m.measured
    begin = utc(int(times.min())) if len(times) else "—"
    lasts = minutes(int(times.max() - times.min())) if len(times) else "—"
    accepted = sum(c.accepted for c in m.closures)
    refused = sum(not c.accepted and not c.revised for c in m.closures)
    jumps = m.info.get("jumps")
    noises = [
        f"{np.degrees(noise.heading_rad_per_sqrt_m):.2f}°/√m",
        f"{100 * noise.miss_rate:.1f} %",
        f"{100 * noise.branch_fault_rate:.1f} %",
    ]
    return [
        begin,
        lasts,
        f"{len(times):,}",
        f"{len(m):,}",
        f"{len(m.source):,} ({float(m.length.sum()):,.0f} m)",
        f"{accepted:,}",
        f"{refused:,}",
        *(noises if len(times) else ["—"] * len(noises)),
        str(len(jumps)) if isinstance(jumps, Sequence) else "0",
    ]
