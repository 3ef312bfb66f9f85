"""The maps of a report: one for each site, with layers, drawn by Bokeh in the reader's browser.

Colours are seen on white and on dark paper alike. A renderer's name is the layer that it belongs
to; the column `told` of its source is what a click on it says.
"""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d, WheelZoomTool
from bokeh.models.annotations.legends import ScaleBar
from bokeh.plotting import figure
from PIL import Image

from ..merge.change import Change, ChangeKind, numbered
from ..merge.drive import Drive
from ..merge.result import Component, FusedMap, MergeResult, site_views
from ..topology.arrays import FloatArray, IntArray
from ..topology.driven_branches import driven_branches
from ..topology.polyline import simplify
from ..topology.run import Grid
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import counted, legible, listed
from .geometry import LINE_SHARE, TURNED, TURNED_MARKERS, bounds, changed_path, strands
from .pages import describe_corridor
from .palette import LIGHT
from .parts import ranks, rows_of
from .sheet import upright_rad
from .walls import wall_points, walls_of

INK, FAINT, CHOSEN = "#6f7682", "#9aa2ae", "#c026d3"
"""Text and junctions, corridors, and what was clicked: a contrast of 4 or more, 2.5, and 4 on white
and on the dark page."""

GOOD, BAD, PLANNED = LIGHT["agrees"], LIGHT["against"], "#8b5cf6"

CHANGED = {ChangeKind.GONE: BAD, ChangeKind.NEW: GOOD, ChangeKind.DIFFERS: PLANNED}

PICTURE_PX = 700.0
"""A map's width on a page of usual width."""

PEN_PX = 2.4
"""Width of a run's line where the map fills its picture, within LINE_SHARE."""

SCALE_BAR = 0.04
"""Room for the scale bar below a map, and for numbers at its right, over its extent."""

STRAIGHT_M = 0.05
"""Corridors are drawn with as few points as stay within it of the whole line [m]."""

MOST_RUNS = 8
"""Runs that a click names; of the others it gives the number."""


def site_map(
    result: MergeResult,
    own: Component,
    maps: Mapping[str, TopoMap],
    changes: Sequence[Change],
    drives: Sequence[Drive],
) -> Any:
    """A figure of one component of a merge, turned upright. maps: of its runs; changes, drives: of
    all components."""
    fused = result.fused
    (vertices,) = rows_of(fused.component, [own.id])
    (edges,) = rows_of(fused.component[fused.source], [own.id])
    paths = [fused.paths[e] for e in edges.tolist()]
    begun = [(k, drive) for k, drive in enumerate(drives, 1) if drive.component == own.id]
    T = np.array([0.0, 0.0, upright_rad(paths)])
    walls = walls_of([v.moved(T) for v in site_views(fused, own, maps)], own.name)
    extents = np.concatenate([fused.xy[vertices], *paths, *(drive.path for _, drive in begun)])
    plot = map_figure([apply(T, extents), wall_points(walls)])
    plot.update(tags=[usual_m(fused.length[edges])])
    site = _Site(plot, fused, own, T, vertices, edges)
    if walls is not None:
        site.walls(walls)
    site.corridors()
    site.runs(ranks(result))
    site.unexplored()
    site.changes([c for c in changes if c.component == own.id and c.sure])
    site.drives(begun)
    site.junctions()
    site.frame()
    return plot


def blank_figure(x: Sequence[float], y: Sequence[float], tools: str, **more: Any) -> Any:
    """A transparent figure without frame and toolbar that fills its place on the page. x, y: begin
    and end of its axes; more: of Bokeh's figures."""
    across, up = (Range1d(start=round(float(a), 2), end=round(float(b), 2)) for a, b in (x, y))
    return figure(
        x_range=across,
        y_range=up,
        tools=tools,
        toolbar_location=None,
        sizing_mode="stretch_both",
        min_border=0,
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        **more,
    )


def map_figure(points: Sequence[FloatArray]) -> Any:
    """An empty figure that holds all points, (k, 2) each [m]; the page keeps both axes to one
    scale."""
    low, high = bounds(points)
    spare = SCALE_BAR * float((high - low).max())
    low[1], high[0] = low[1] - spare, high[0] + spare
    plot = blank_figure((low[0], high[0]), (low[1], high[1]), "pan,tap")
    wheel = WheelZoomTool(modifiers="ctrl")
    plot.add_tools(wheel)
    plot.toolbar.update(active_scroll=wheel)
    for part in (*plot.axis, *plot.grid):
        part.update(visible=False)
    bar = ScaleBar(
        range=plot.x_range,
        unit="m",
        location="bottom_left",
        background_fill_color=None,
        border_line_color=None,
        bar_line_color=INK,
        label_text_color=INK,
        label_location="above",
        margin=4,
        padding=2,
        bar_length=0.15,
    )
    plot.add_layout(bar)
    return plot


def usual_m(lengths: FloatArray) -> float:
    """The median length of corridors [m], by which the page tells how large a map is drawn."""
    return round(float(np.median(lengths)), 2) if len(lengths) else 1.0


def columns(xy: FloatArray) -> tuple[list[float], list[float]]:
    """x and y of points (n, 2) to the centimetre."""
    x, y = np.round(np.reshape(xy, (-1, 2)).T + 0.0, 2).tolist()
    return x, y


@dataclass(frozen=True, slots=True, eq=False)
class _Site:
    """The figure of a component, its own. T: the pose in the figure of its frame; vertices, edges:
    its rows."""

    plot: Any
    fused: FusedMap
    own: Component
    T: FloatArray
    vertices: IntArray
    edges: IntArray

    def walls(self, grid: Grid) -> None:
        """Walls dark, free space light. grid: along the axes of the figure."""
        pixels = np.zeros((*grid.free.shape, 4), np.uint8)
        pixels[grid.free] = (128, 138, 154, 28)
        pixels[~grid.free & ~grid.unknown] = (112, 122, 138, 150)
        out = io.BytesIO()
        Image.fromarray(pixels[::-1]).quantize(4).save(out, "PNG", optimize=True)
        url = "data:image/png;base64," + b64encode(out.getvalue()).decode()
        high, wide = (count * grid.resolution_m for count in grid.free.shape)
        place = {"x": [grid.origin[0]], "y": [grid.origin[1]], "w": [wide], "h": [high]}
        self.plot.image_url(
            url="url",
            source=ColumnDataSource({"url": [url], **place}),
            **{name: name for name in place},
            anchor="bottom_left",
            name="walls",
        )

    def corridors(self) -> None:
        """Every corridor as one line, to be clicked; faint under the lines of several runs."""
        f, rows = self.fused, self.edges.tolist()
        tips = []
        for e in rows:
            what, runs = describe_corridor(f, e), sorted({run for run, _ in f.edge_members[e]})
            tips.append(f"{what[0].upper()}{what[1:]} by {listed(runs, MOST_RUNS)}")
        paths, alpha = [f.paths[e] for e in rows], 0.45 if len(self.own.poses) > 1 else 0.9
        self._lines(paths, tips, FAINT, "", line_width=3.0, line_alpha=alpha)

    def runs(self, rank: Mapping[str, int]) -> None:
        """A line beside the others for each of several runs that drove a corridor."""
        if len(self.own.poses) < 2:
            return
        extent = self.plot.x_range.end - self.plot.x_range.start
        usual = usual_m(self.fused.length[self.edges])
        found = strands(
            self.fused, self.edges, min(PEN_PX * extent / PICTURE_PX, LINE_SHARE * usual)
        )
        x, y = self._path_columns(strand.path for strand in found)
        inks = [LIGHT.run(rank[strand.run]) for strand in found]
        source = ColumnDataSource({"xs": x, "ys": y, "ink": inks})
        look = {"line_color": "ink", "line_width": PEN_PX * 0.8}
        self.plot.multi_line("xs", "ys", source=source, name="runs", **look)

    def unexplored(self) -> None:
        """Branches that nobody drove."""
        f, branches = self.fused, self.fused.branches
        free = ~driven_branches(f) & np.isin(branches.owner, self.vertices)
        if not free.any():
            return
        x, y = columns(apply(self.T, f.xy[branches.owner[free]]))
        heading = np.round(branches.values[free] + self.T[2], 3).tolist()
        source = ColumnDataSource({"x": x, "y": y, "angle": heading})
        look = {"length": 14, "length_units": "screen", "line_color": PLANNED, "line_width": 2}
        name = "branches never driven"
        self.plot.ray("x", "y", source=source, angle="angle", name=name, **look)

    def changes(self, shown: Sequence[Change]) -> None:
        """What is gone, new, or there at times."""
        if not shown:
            return
        told = numbered(shown)
        for kind, ink in CHANGED.items():
            some = [c for _, c in told if c.kind is kind]
            paths = [changed_path(self.fused, self.edges, c) for c in some]
            tips = [describe_change(c, self.own.name) for c in some]
            self._lines(paths, tips, ink, "changes", line_width=6.0, line_alpha=0.6)
            places = [k for k, c in enumerate(some) if c.edge is None]
            at = np.array([some[k].xy for k in places])
            self._dots(at, [tips[k] for k in places], ink, "changes", 16.0, ring=True)
            numbers = [f"{k}" for k, c in told if c.kind is kind]
            at = np.array([c.xy for c in some])
            look = {"text_font_style": "bold", "level": "annotation"}  # above the junctions
            self._words(at, numbers, ink, "changes", (8, -12), **look)

    def drives(self, found: Sequence[tuple[int, Drive]]) -> None:
        """What to record next: the way, and a ring where it begins."""
        if not found:
            return
        tips = [f"Drive {k}: {'; '.join(drive.words)}; {drive.way}" for k, drive in found]
        paths = [drive.path for _, drive in found]
        self._lines(paths, tips, PLANNED, DRIVES, line_width=6.0, line_alpha=0.6)
        begins = np.array([drive.stops[0].xy for _, drive in found])
        self._dots(begins, tips, PLANNED, DRIVES, 18.0, ring=True)
        together: dict[int | None, list[int]] = {}
        for row, (_, drive) in enumerate(found):
            together.setdefault(drive.stops[0].junction, []).append(row)
        names = [
            f"drive{'s' if len(rows) > 1 else ''} {', '.join(str(found[r][0]) for r in rows)}"
            for rows in together.values()
        ]
        first = begins[[rows[0] for rows in together.values()]]
        self._words(first, names, PLANNED, DRIVES, (10, -22), text_font_style="bold")
        stops = [s for _, drive in found for s in drive.stops if s.site != self.own.name]
        beyond = [s for s in stops if s.junction is not None]
        at = np.array([s.xy for s in beyond])
        self._words(at, [str(s.junction) for s in beyond], PLANNED, NUMBERS, (6, 12))

    def junctions(self) -> None:
        """Junctions, larger where several runs saw them, and their numbers; where a log ends or a
        robot turned round."""
        f = self.fused
        turned = np.array([f.kind[v] in TURNED for v in self.vertices.tolist()], bool)
        for kind, marker in TURNED_MARKERS.items():
            rows = [v for v in self.vertices[turned].tolist() if f.kind[v] == kind]
            runs = [listed(sorted(f.members[v]), MOST_RUNS) for v in rows]
            tips = [f"Here {TURNED[kind]} ({who})" for who in runs]
            self._dots(f.xy[rows], tips, LIGHT["degree 1"], "", 6.0, marker=marker)
        rows = self.vertices[~turned].tolist()
        for shared, size in ((False, 7.0), (True, 10.0)):
            some = [v for v in rows if (len(f.members[v]) > 1) == shared]
            tips = [self._describe_junction(v) for v in some]
            self._dots(f.xy[some], tips, INK, "", size, number=some)
        self._words(f.xy[rows], list(map(str, rows)), INK, NUMBERS, (6, -8))

    def _describe_junction(self, v: int) -> str:
        """A fused junction in a line: branches, passes, runs, position."""
        f = self.fused
        runs = sorted(f.members[v])
        sigma = f.position_sigma
        sure = "" if sigma is None or np.isnan(sigma[v]) else f", ± {sigma[v]:.2f} m"
        x, y = f.xy[v]
        kind = f.kind[v].replace("_", " ")
        own = [f"{run} (its {', '.join(map(str, f.members[v][run]))})" for run in runs]
        return (
            f"Junction {v}{'' if kind == 'junction' else f' ({kind})'}: "
            f"{counted(len(f.branches[v]), 'branch', 'branches')}, "
            f"{counted(len(f.observations[v]), 'pass', 'passes')} by {listed(own, MOST_RUNS)}; at "
            f"({x:.2f}, {y:.2f}) m{sure}"
        )

    def frame(self) -> None:
        """The axes of the site's frame at its origin."""
        reach = 0.05 * (self.plot.x_range.end - self.plot.x_range.start)
        tips = np.array([(reach, 0.0), (0.0, reach)])
        x, y = self._path_columns(np.stack([np.zeros(2), tip]) for tip in tips)
        source = ColumnDataSource({"xs": x, "ys": y})
        self.plot.multi_line("xs", "ys", source=source, line_color=INK, line_width=1.2, name="axes")
        self._words(1.3 * tips, ["x", "y"], INK, "axes", (0, 0), text_align="center")

    def _path_columns(self, paths: Iterable[FloatArray]) -> tuple[Any, Any]:
        """x and y of each polyline of the site's frame, in the figure."""
        both = [columns(simplify(apply(self.T, path), STRAIGHT_M)) for path in paths]
        return [x for x, _ in both], [y for _, y in both]

    # ink: colour; layer: "" for what is always shown; look: of Bokeh's glyphs.

    def _lines(
        self, paths: Sequence[FloatArray], tips: Sequence[str], ink: str, layer: str, **look: Any
    ) -> None:
        """Polylines, (k, 2) each in the site's frame, and what a click on one says."""
        x, y = self._path_columns(paths)
        self.plot.multi_line(
            "xs",
            "ys",
            source=ColumnDataSource({"xs": x, "ys": y, "told": list(map(legible, tips))}),
            line_color=ink,
            line_cap="round",
            line_join="round",
            name=layer or None,
            nonselection_line_alpha=look.get("line_alpha", 1.0),
            selection_line_color=CHOSEN,
            **look,
        )

    def _dots(
        self,
        xy: FloatArray,
        tips: Sequence[str],
        ink: str,
        layer: str,
        size: float,
        *,
        ring: bool = False,
        number: Sequence[int] = (),
        **look: Any,
    ) -> None:
        """Marks or rings at xy (n, 2) in the site's frame, and what a click on one says; number: of
        junctions, by which the page finds them."""
        if not len(tips):
            return
        x, y = columns(apply(self.T, xy))
        given = {"x": x, "y": y, "told": list(map(legible, tips))}
        given |= {"number": list(number)} if len(number) else {}
        self.plot.scatter(
            "x",
            "y",
            source=ColumnDataSource(given),
            size=size,
            fill_color=None if ring else ink,
            line_color=ink,
            line_width=2.5 if ring else 0,
            name=layer or None,
            nonselection_fill_alpha=1.0,
            nonselection_line_alpha=1.0,
            selection_fill_color=CHOSEN,
            selection_line_color=CHOSEN,
            **look,
        )

    def _words(
        self,
        xy: FloatArray,
        words: Sequence[str],
        ink: str,
        layer: str,
        offset: tuple[int, int],
        **look: Any,
    ) -> None:
        """Words beside points xy (n, 2) of the site's frame. offset: to the right and down
        [pixels]."""
        if not len(words):
            return
        x, y = columns(apply(self.T, xy.reshape(-1, 2)))
        source = ColumnDataSource({"x": x, "y": y, "text": list(map(legible, words))})
        self.plot.text(
            "x",
            "y",
            "text",
            source=source,
            x_offset=offset[0],
            y_offset=offset[1],
            text_color=ink,
            text_baseline="middle",
            text_font_size="11px",
            name=layer,
            **look,
        )


DRIVES = "drives to record"
NUMBERS = "junction numbers"
"""Of this layer the page shows what has room."""


def describe_change(change: Change, site: str) -> str:
    """What changed, when, for whom and how surely, as sentences on one line."""
    return " ".join(f"{words[0].upper()}{words[1:]}." for words in change.words(site))


def own_map(topomap: TopoMap) -> dict[str, Any]:
    """A run's own map as JSON values: vertices, junctions first, polylines, and the turn that draws
    it upright."""
    m = with_turning_points(topomap)
    x, y = columns(m.xy)
    paths = [columns(simplify(path, STRAIGHT_M)) for path in m.paths]
    return {
        "x": x,
        "y": y,
        "junctions": len(topomap),
        "paths": paths,
        "turn": round(upright_rad(m.paths), 4),
        "usual": usual_m(m.length),
    }
