"""The maps of a report: one for each site, drawn by Bokeh in the reader's browser.

Colours are seen on white and on dark paper alike. A renderer's name is its entry in the key, which
hides and shows it; the column `lines` of its source is what a click on it says.
"""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d, WheelZoomTool
from bokeh.models.annotations.legends import ScaleBar
from bokeh.plotting import figure
from numpy.typing import NDArray
from PIL import Image

from ..merge.change import Change
from ..merge.drive import Drive
from ..merge.result import Component, MergeResult, site_views
from ..topology.arrays import BoolArray, FloatArray
from ..topology.polyline import simplify
from ..topology.run import Grid
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import legible
from .geometry import FINEST_M, MARGIN, PENS, usual_m
from .palette import BOTH, MEDIUM, THIN, rgb
from .parts import lay_out
from .scene import draw_component, draw_walls
from .sheet import upright_rad
from .surface import Look
from .walls import wall_points, walls_of

CHOSEN = BOTH["pink"]
"""What was clicked."""

PICTURE_PX = 700.0
"""A map's width on a page of usual width."""

PEN_PX = 2.0
"""Width of a corridor's line where the map fills its picture; the page draws all marks smaller
where corridors are short."""

NUMBERS = "numbers"
"""Of this layer the page shows what has room."""


def site_map(
    result: MergeResult,
    own: Component,
    maps: Mapping[str, TopoMap],
    *,
    changes: Sequence[Change],
    drives: Sequence[Drive],
    undriven: BoolArray,
) -> Any:
    """A figure of one component of a merge, turned upright. maps: of its runs; changes, drives: of
    all components; undriven: branches of the merged map that nobody drove (total branches,)."""
    fused = result.fused
    views = site_views(fused, own, maps)
    to_hold = [drive.path for drive in drives if drive.component == own.id]
    to_hold.append(wall_points(walls_of(views, "")))
    (part,) = lay_out(result, {own.id: np.concatenate(to_hold)}, [own.id])
    surface = SiteFigure(part.cell.low, part.cell.high, usual_m(fused.length[part.edges]))
    draw_walls(surface, views, part.cell.T_sheet_map, surface.theme.ink, alpha=0.5)
    draw_component(
        surface,
        fused,
        part,
        several=1,
        detailed=True,
        numbers=None,
        drives=drives,
        changes=changes,
        undriven=undriven,
    )
    return surface.plot


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


def map_figure(low: FloatArray, high: FloatArray) -> Any:
    """An empty figure that shows what lies between two corners, (2,) each [m], with room for a
    scale bar and for numbers; the page keeps both axes to one scale."""
    spare = MARGIN * float((high - low).max())
    plot = blank_figure((low[0], high[0] + spare), (low[1] - spare, high[1]), "pan,tap")
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
        bar_line_color=BOTH.ink,
        label_text_color=BOTH.ink,
        label_location="above",
        margin=4,
        padding=2,
        bar_length=0.2,
    )
    plot.add_layout(bar)
    return plot


def columns(xy: FloatArray) -> tuple[list[float], list[float]]:
    """x and y of points (n, 2) to the centimetre."""
    x, y = np.round(np.reshape(xy, (-1, 2)).T + 0.0, 2).tolist()
    return x, y


class SiteFigure:
    """A Bokeh figure as a `Surface`. usual: length of a usual corridor [m]."""

    theme = BOTH

    def __init__(self, low: FloatArray, high: FloatArray, usual: float) -> None:
        self.plot = map_figure(low, high)
        self.plot.update(tags=[round(usual, 2)])
        self.pen_m = min(PEN_PX * float((high - low).max()) / PICTURE_PX, usual / PENS)

    def lines(self, paths: Sequence[FloatArray], look: Look) -> None:
        """Draw polylines; a click on one tells its tip."""
        if not paths:
            return
        x, y = path_columns(paths)
        self.plot.multi_line(
            "xs",
            "ys",
            source=_source({"xs": x, "ys": y}, look.tips),
            line_color=look.colour,
            line_width=max(look.pens, THIN) * PEN_PX,
            line_cap="round",
            line_join="round",
            name=look.key or None,
            nonselection_line_alpha=1.0,
            selection_line_color=CHOSEN,
        )

    def dots(self, xy: FloatArray, look: Look) -> None:
        """Draw marks; a click on one tells its tip."""
        if not len(xy):
            return
        x, y = columns(xy)
        self.plot.scatter(
            "x",
            "y",
            source=_source({"x": x, "y": y}, look.tips),
            # Bokeh's diamond is as high as a square and narrower.
            size=look.pens * PEN_PX * (np.sqrt(2) if look.marker == "diamond" else 1.0),
            marker=look.marker,
            fill_color=None if look.ring else look.colour,
            line_color=look.colour,
            line_width=PEN_PX if look.ring else 0,
            name=look.key or None,
            nonselection_fill_alpha=1.0,
            nonselection_line_alpha=1.0,
            selection_fill_color=CHOSEN,
            selection_line_color=CHOSEN,
        )

    def words(self, xy: FloatArray, texts: Sequence[str], *, bold: bool = False) -> None:
        """Write texts, bold ones on the other side than numbers; the page leaves out what has no
        room."""
        if len(texts):
            side, style = ("right", "bold") if bold else ("left", "normal")
            write_beside(self.plot, xy, texts, BOTH.ink, side, text_font_style=style)

    def cells(self, grid: Grid, look: Look, alpha: float = 1.0) -> None:
        """Draw cells, as a picture; as of `Surface`."""
        pixels = np.zeros((*grid.free.shape, 4), np.uint8)
        pixels[~grid.free & ~grid.unknown] = (*rgb(look.colour), round(255 * alpha))
        high, wide = (count * grid.resolution_m for count in grid.free.shape)
        place = {"x": [grid.origin[0]], "y": [grid.origin[1]], "w": [wide], "h": [high]}
        self.plot.image_url(
            url="url",
            source=ColumnDataSource({"url": [picture(pixels)], **place}),
            **{name: name for name in place},
            anchor="bottom_left",
            name=look.key,
        )


def picture(pixels: NDArray[np.uint8]) -> str:
    """The address of a picture within the page. pixels: (h, w, 4), row 0 below, of few colours."""
    out = io.BytesIO()
    Image.fromarray(pixels[::-1]).quantize(8).save(out, "PNG", optimize=True)
    return "data:image/png;base64," + b64encode(out.getvalue()).decode()


def _source(given: dict[str, Any], tips: Sequence[str]) -> ColumnDataSource:
    """The source of marks, and what a click on each says."""
    return ColumnDataSource(given | ({"lines": list(map(legible, tips))} if len(tips) else {}))


def path_columns(paths: Sequence[FloatArray]) -> tuple[Any, Any]:
    """x and y of each polyline, simplified."""
    both = [columns(simplify(path, FINEST_M)) for path in paths]
    return [x for x, _ in both], [y for _, y in both]


def write_beside(
    plot: Any, xy: FloatArray, texts: Sequence[str], ink: str, side: str, **look: Any
) -> None:
    """Write a text beside each of the points (n, 2). side: of the text at which the point is:
    "left", then it stands above, or "right", below; look: of Bokeh's texts."""
    x, y = columns(xy)
    plot.text(
        "x",
        "y",
        "text",
        source=ColumnDataSource({"x": x, "y": y, "text": list(map(legible, texts))}),
        x_offset=(1 if side == "left" else -1) * MEDIUM * PEN_PX,
        y_offset=(-1 if side == "left" else 1) * MEDIUM * PEN_PX,
        text_color=ink,
        text_align=side,
        text_baseline="middle",
        text_font_size="11px",
        name=NUMBERS,
        level="annotation",
        **look,
    )


def own_map(topomap: TopoMap) -> dict[str, Any]:
    """A run's own map as JSON values: vertices, junctions first, polylines, and the turn that draws
    it upright."""
    m = with_turning_points(topomap)
    x, y = columns(m.xy)
    paths = [columns(simplify(path, FINEST_M)) for path in m.paths]
    return {
        "x": x,
        "y": y,
        "junctions": len(topomap),
        "paths": paths,
        "turn": round(upright_rad(m.paths), 4),
        "usual": round(usual_m(m.length), 2),
    }
