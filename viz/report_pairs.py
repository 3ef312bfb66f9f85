"""The verdicts of a merge in a report: the matrix of all pairs, and what a click on one opens."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, FixedTicker, LinearColorMapper
from numpy.typing import NDArray

from ..merge.decision import LINKS, Decision, Placement
from ..merge.decision_text import (
    advice,
    because,
    digits_of,
    itemised,
    named_views,
    needs,
    rows,
    short,
    to_record,
)
from ..merge.result import Alignment, MergeResult, PairVerdict, Standing, shown_bits
from ..topology.matching.views import SILENT, Compared
from ..topology.se2 import turned
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.views import CELL_M
from ..topology.wording import legible
from .geometry import between
from .palette import BOTH, RING, SMALL, THIN, rgb
from .parts import in_order, runs_in_order
from .report_maps import (
    CHOSEN,
    PEN_PX,
    blank_figure,
    map_figure,
    own_map,
    path_columns,
    picture,
    write_beside,
)
from .scene import view_layers
from .sheet import upright_rad

FAINT = "50"
"""The opacity, in hexadecimal, of what lies under other marks or says little."""

STANDING_COLOURS = {
    Standing.MERGED: BOTH["green"],
    Standing.JOINED: BOTH["green"] + FAINT,
    Standing.AMBIGUOUS: BOTH["orange"],
    Standing.KEPT_OUT: BOTH["red"],
    Standing.UNRELATED: BOTH["single"] + FAINT,
}
"""The colour of each standing of a pair, on white and on dark paper."""

DIAGONAL = 0
CLASS = {standing: k for k, standing in enumerate(Standing, start=DIAGONAL + 1)}
"""Class of each standing in the verdict matrix."""

MOST_NAMES = 40
"""Up to this many runs the matrix has their names; of more those of their sites."""

MOST_LINKS = 12
"""Links of a placement that are listed one by one."""


def matrix_figure(result: MergeResult) -> Any:
    """The standing of every pair as a coloured square, the runs of a site framed; row 0 on top."""
    runs, spans = runs_in_order(result), spans_of(result)
    n = len(runs)
    plot: Any = blank_figure((0, n), (n, 0), "")
    plot.update(outline_line_color=BOTH.ink)
    colours = [BOTH["single"], *(STANDING_COLOURS[s] for s in CLASS)]
    mapper = LinearColorMapper(palette=colours, low=-0.5, high=len(colours) - 0.5)
    plot.image(image=[verdict_matrix(result)], x=0, y=0, dw=n, dh=n, color_mapper=mapper)
    begins, ends = ([span[k] for span in spans if span[2] - span[1] > 1] for k in (1, 2))
    sides = {"left": begins, "right": ends, "top": begins, "bottom": ends}
    framed, look = (
        ColumnDataSource(sides),
        {"fill_color": None, "line_color": BOTH.ink, "line_width": 2},
    )
    plot.quad("left", "right", "top", "bottom", source=framed, **look)
    spot = ColumnDataSource({"x": [], "y": []}, name="spot")
    look = {"fill_color": None, "line_color": CHOSEN, "line_width": 3}
    plot.rect("x", "y", 1, 1, source=spot, name="spot", **look)
    names = {k + 0.5: run for k, run in enumerate(runs)}
    if n > MOST_NAMES:
        names = {(b + e) / 2: site for site, b, e in spans if e - b >= n / MOST_NAMES}
    for part in plot.grid:
        part.update(visible=False)
    for axis in (plot.xaxis[0], plot.yaxis[0]):
        axis.update(
            ticker=FixedTicker(ticks=sorted(names)),
            major_label_overrides={at: short(legible(name)) for at, name in names.items()},
            major_label_text_color=BOTH.ink,
            major_label_text_font_size="10px",
            major_label_standoff=2,
            major_tick_line_color=None,
            axis_line_color=None,
        )
    plot.xaxis[0].update(major_label_orientation="vertical")
    return plot


def spans_of(result: MergeResult) -> list[tuple[str, int, int]]:
    """The name of every site, its first row by `runs_in_order`, and the row after its last."""
    order = in_order(result)
    stops = np.cumsum([0, *(len(c.poses) for c in order)]).tolist()
    return [(c.name, *ends) for c, ends in zip(order, pairwise(stops), strict=True)]


def verdict_matrix(result: MergeResult) -> NDArray[np.uint8]:
    """(n, n) classes of all pairs, symmetric, rows and columns by `runs_in_order`."""
    row = {run: i for i, run in enumerate(runs_in_order(result))}
    matrix = np.full((len(row), len(row)), CLASS[Standing.UNRELATED], np.uint8)
    if result.unlisted is not None:
        for component in result.components:  # pairs that are not listed
            rows = [row[run] for run in component.poses]
            matrix[np.ix_(rows, rows)] = CLASS[Standing.JOINED]
    np.fill_diagonal(matrix, DIAGONAL)
    for pair in result.verdicts:
        i, j = row[pair.a], row[pair.b]
        matrix[i, j] = matrix[j, i] = CLASS[pair.standing]
    return matrix


def pair_figure() -> Any:
    """A figure for one map laid over another, which the page fills. The sources of its renderers
    are named after what they hold."""
    plot = map_figure(np.zeros(2), np.ones(2))
    one, two = BOTH.run(0), BOTH.run(1)
    for name, ink, pens in (
        ("record", BOTH["planned"], RING),
        ("links", BOTH["agrees"] + FAINT, RING),
        ("a", one, 1),
        ("b", two, 1),
        ("ties", BOTH.ink, THIN),
        ("crossing", BOTH["against"], SMALL),
    ):
        source = ColumnDataSource({"xs": [], "ys": []}, name=name)
        plot.multi_line("xs", "ys", source=source, line_color=ink, line_width=pens * PEN_PX)
    for name, ink, pens in (
        ("a dots", one, SMALL),
        ("b dots", two, SMALL),
        ("against", BOTH["against"], RING),
    ):
        source = ColumnDataSource({"x": [], "y": []}, name=name)
        ring = name == "against"
        look = {"fill_color": None if ring else ink, "line_width": PEN_PX if ring else 0}
        plot.scatter("x", "y", source=source, size=pens * PEN_PX, line_color=ink, **look)
    for name, ink, side in (("a numbers", one, "right"), ("b numbers", two, "left")):
        write_beside(plot, np.zeros((0, 2)), (), ink, side)
        plot.renderers[-1].data_source.update(name=name)
    return plot


def page_data(
    result: MergeResult | None,
    runs: Sequence[str],
    maps: Mapping[str, TopoMap],
    decisions: Mapping[tuple[str, str], Decision],
    where: Sequence[str],
    *,
    as_merged: bool,
) -> dict[str, Any]:
    """What the page knows of runs and pairs, as JSON values.

    decisions: on the pairs whose evidence is shown line by line; where: options that name the
    workspace in a call; as_merged: whether the maps are those that were merged, so that they have
    the junctions that placements name.
    """
    row = {run: k for k, run in enumerate(runs)}
    home = result.home if result else {}
    reasons: dict[str, int] = {}
    pairs = []
    verdicts = result.verdicts if result else ()
    for p in sorted(verdicts, key=lambda p: (-p.evidence_bits, p.a, p.b)):
        number = reasons.setdefault(legible(p.reason), len(reasons))
        entry: dict[str, Any] = {"i": row[p.a], "j": row[p.b], "s": CLASS[p.standing] - 1}
        entry |= {"r": number, "bits": shown_bits(p.evidence_bits)}
        pairs.append(entry | _opened(p, decisions.get((p.a, p.b)), maps if as_merged else {}))
    return {
        "runs": [
            {"name": legible(run), "shell": shlex.quote(run)}
            | ({"map": own_map(maps[run])} if run in maps else {})
            | ({"site": home[run]} if run in home else {})
            for run in runs
        ],
        "standings": [str(s) for s in CLASS],
        "colours": [STANDING_COLOURS[s] for s in CLASS],
        "ink": BOTH.ink,
        "inks": [BOTH.run(0), BOTH.run(1)],
        "reasons": list(reasons),
        "pairs": pairs,
        "counted": result is not None and result.unlisted is not None,
        "where": shlex.join(where),
    }


def _opened(
    pair: PairVerdict, decision: Decision | None, maps: Mapping[str, TopoMap]
) -> dict[str, Any]:
    """Advice, locks and placements of a pair, with the evidence line by line where there is a
    decision."""
    out: dict[str, Any] = {}
    if pair.advice:
        out["advice"] = legible(pair.advice)
    if pair.locked:
        out["locked"] = pair.locked
    if decision is not None:
        need = shown_bits(decision.requirement.threshold_bits, digits_of(decision))
        lines = [because(decision), advice(decision), f"{need} bits needed: {needs(decision)}"]
        lines += [f"Note: {note}" for note in decision.notes]
        out["lines"] = [legible(line) for line in lines if line]
        digits = digits_of(decision)
        out["rows"] = [
            [row.level, legible(row.text), row.a, row.b]
            + ["" if bits is None else f"{bits:+z.{digits}f}" for bits in row.bits]
            for row in rows(decision, MOST_LINKS)
        ]
        placed = [_placed(p.alignment, maps, pair, p) for p in decision.placements]
    else:
        placed = [_placed(a, maps, pair) for a in (pair.best, pair.runner_up) if a is not None]
    if shown := [p for p in placed if p is not None]:
        out["placed"] = shown
        if not pair.through and (asked := to_record(pair)) is not None:
            run, ends = asked
            paths = path_columns(between(with_turning_points(maps[run]), ends))
            out["record"] = [int(run == pair.b), ends, paths]
    return out


def _seen(seen: Compared, turn_rad: float) -> str:
    """A picture of the walls of two views over each other, turned: those of a twice as wide, faint
    where nothing is known of them in the other view."""
    xy = turned(seen.xy, turn_rad)
    reach = np.abs(xy).max(initial=0.0) + CELL_M
    at = np.floor((xy + reach) / (CELL_M / 2)).astype(np.int64)
    pixels = np.zeros((*(2 * [at.max(initial=0) + 2]), 4), np.uint8)
    for which, ink, kind, run in view_layers(seen, BOTH):
        x, y = at[which].T
        for right, up in product(range(2 - run), repeat=2):
            pixels[y + up, x + right] = (*rgb(ink), int(FAINT, 16) if kind == SILENT else 255)
    return picture(pixels)


def _placed(
    alignment: Alignment,
    maps: Mapping[str, TopoMap],
    pair: PairVerdict,
    placement: Placement | None = None,
) -> dict[str, Any] | None:
    """A placement to be drawn; None without both maps."""
    if not {pair.a, pair.b} <= maps.keys():
        return None
    x, y, turn = alignment.transform.tolist()
    out: dict[str, Any] = {
        "t": [round(x, 3), round(y, 3), round(turn, 5)],
        "bits": shown_bits(alignment.evidence_bits),
        "ties": alignment.matched.tolist(),
        "against": [legible(told) for told in alignment.contradictions],
        "spots": [[list(a), list(b)] for a, b in alignment.contradicting],
    }
    if placement is not None:
        links = itemised(placement, LINKS)
        turn = upright_rad(maps[pair.a].paths)
        views = [(t, t.seen) for t in placement.of("views") if t.seen is not None]
        out["views"] = [[named_views(t), _seen(seen, turn)] for t, seen in views]
        out["links"] = [list(t.a) for t in links if t.bits > 0 and len(t.a) == 2]
    return out
