"""A matplotlib page with a drawing in metres, a heading above it, a scale bar and a key below it.

matplotlib is imported by this module. Sizes on the page are in points (1/72 inch).
"""

from __future__ import annotations

import io
import re
import unicodedata
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, floor, log10
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context, rcdefaults, rcParams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from ..topology.arrays import FloatArray
from ..topology.wording import legible
from .palette import Order, Theme

Form = Literal["title", "line", "wide line", "dot", "big dot", "ring", "stub"]
Format = Literal["svg", "png"]

POINTS_PER_INCH = 72.0
TEXT_PT, SMALL_PT, HEADING_PT = 8.0, 6.5, 11.0
LINE_PT = 13.0
"""Line spacing of text."""

EDGE_PT = 12.0
"""Margin of the page."""

HANDLE_PT, GAP_PT = 26.0, 14.0
"""Width of the sample mark in a key entry, and the gap between two columns of entries."""

LETTER = 0.62
"""Estimated width of a letter over the font size; East Asian wide letters count 1."""

TALLEST = 1.6
"""Largest ratio of height to width of the drawing; a taller one is scaled down to it."""

PNG_DPI = 150
"""Resolution of a PNG [pixels per inch]."""

_STYLE: dict[Any, Any] = {
    # A fixed salt makes the ids of clip paths and markers, and so the file, deterministic.
    "svg.hashsalt": "topobatch",
    # Text is written as text, not as outlines: it can be searched, copied and read aloud.
    "svg.fonttype": "none",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "path.simplify": False,
}
_SVG = "http://www.w3.org/2000/svg"
_XLINK = "http://www.w3.org/1999/xlink"
_NUMBERS = ("d", "x", "y", "transform", "width", "height")
"""SVG attributes whose numbers are rounded."""


@dataclass(frozen=True, slots=True)
class Key:
    """One entry of the key: a sample of a mark and its label. A "title" heads the entries that
    follow."""

    form: Form
    colour: str
    label: str


@dataclass(frozen=True, slots=True)
class _Block:
    """Entries laid out in columns, `step` points apart, of `rows` rows each."""

    keys: Sequence[Key]
    step: float
    rows: int


@dataclass(slots=True)
class Canvas:
    """A drawing of the rectangle between two corners, `low` and `high`, (2,) each [m].

    width_pt: width of the whole page. Text may hold any characters: `legible` replaces unprintable
    ones and `fitting` shortens what is too long.
    """

    low: FloatArray
    high: FloatArray
    theme: Theme
    width_pt: float = 720.0
    name: str = "drawing"
    figure: Figure = field(init=False)
    _axes: Any = field(init=False)
    _titles: dict[str, str] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.figure = Figure()
        self._axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        self._axes.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]))

    @property
    def _size_pt(self) -> tuple[float, float]:
        """Width and height of the drawing in metres, on the page [points]."""
        width, height = np.maximum(self.high - self.low, 1e-6).tolist()
        room = self.width_pt - 2 * EDGE_PT
        scale = min(room / width, TALLEST * room / height)
        return scale * width, scale * height

    @property
    def points_per_m(self) -> float:
        """Scale of the drawing."""
        return float(self._size_pt[0] / max(float(self.high[0] - self.low[0]), 1e-6))

    def lines(
        self,
        paths: Sequence[FloatArray],
        colour: str,
        width_pt: float,
        *,
        order: Order = Order.CORRIDOR,
        told: str = "",
    ) -> None:
        """Draw polylines, (k, 2) each [m], in one colour. told: their tooltip in an SVG."""
        if not paths:
            return
        codes = [np.r_[Outline.MOVETO, np.full(len(p) - 1, Outline.LINETO)] for p in paths]
        patch = PathPatch(
            Outline(np.concatenate(paths), np.concatenate(codes)),
            facecolor="none",
            edgecolor=colour,
            linewidth=width_pt,
            capstyle="round",
            joinstyle="round",
            zorder=order,
        )
        self._add(patch, told)

    def dots(
        self,
        xy: FloatArray,
        colour: str,
        size_pt: float,
        *,
        order: Order = Order.JUNCTION,
        told: str = "",
        ring: bool = False,
    ) -> None:
        """Draw filled dots, or rings, at xy (n, 2) [m]. told: their tooltip in an SVG."""
        if len(xy) == 0:
            return
        line = self._markers(xy, colour, size_pt, ring=ring)
        line.set_zorder(order)
        self._add(line, told)

    def _markers(self, xy: FloatArray, colour: str, size_pt: float, *, ring: bool) -> Line2D:
        return Line2D(
            xy[:, 0],
            xy[:, 1],
            linestyle="none",
            marker="o",
            markersize=size_pt,
            markerfacecolor="none" if ring else colour,
            markeredgecolor=colour if ring else self.theme["paper"],
            markeredgewidth=1.2 if ring else 0.5,
        )

    def words(
        self,
        at: tuple[float, float],
        text: str,
        *,
        size_pt: float = TEXT_PT,
        room_m: float | None = None,
    ) -> None:
        """Write a text centred at a point [m], shortened to `room_m` if given."""
        text = legible(text)
        if room_m is not None:
            text = fitting(text, room_m * self.points_per_m, size_pt)
        self._write(self._axes, *at, text, size_pt=size_pt, ha="center", va="center")

    def _add(self, artist: Any, told: str) -> None:
        artist.set_clip_on(False)
        if told:
            gid = f"{self.name}-{len(self._titles)}"
            artist.set_gid(gid)
            self._titles[gid] = told
        self._axes.add_artist(artist)

    def finish(self, heading: Sequence[str], keys: Sequence[Sequence[Key]]) -> None:
        """Lay out the page: heading lines above (empty ones are skipped; the first one is larger),
        a scale bar and the groups of keys below."""
        wide, high = self._size_pt
        room = self.width_pt - 2 * EDGE_PT
        lines = [fitting(text, room, HEADING_PT) for text in heading[:1]]
        lines += [line for text in heading[1:] if text for line in folded(text, room, TEXT_PT)]
        top = LINE_PT * len(lines) + (8.0 if lines else 0.0)
        blocks = [_columns(group, room) for group in keys if group]
        bottom = 26.0 + sum(LINE_PT * block.rows + 6.0 for block in blocks)
        total = 2 * EDGE_PT + top + high + bottom
        self.figure.set_size_inches(self.width_pt / POINTS_PER_INCH, total / POINTS_PER_INCH)
        self.figure.set_facecolor(self.theme["paper"])
        left = EDGE_PT + (room - wide) / 2
        size = np.array([self.width_pt, total])
        corner, extent = np.array([left, EDGE_PT + bottom]), np.array([wide, high])
        self._axes.set_position((*(corner / size), *(extent / size)))
        page = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        page.set(xlim=(0.0, self.width_pt), ylim=(0.0, total))
        page.set_axis_off()
        page.patch.set_visible(False)
        for k, line in enumerate(lines):
            y = total - EDGE_PT - LINE_PT * (k + 0.5)
            size_pt = TEXT_PT if k else HEADING_PT
            self._write(page, EDGE_PT, y, line, bold=k == 0, size_pt=size_pt)
        self._scale_bar(page, EDGE_PT + bottom - 14.0)
        self._keys(page, blocks, EDGE_PT + bottom - 26.0)

    def _scale_bar(self, page: Any, y: float) -> None:
        """Draw a scale bar of at most a fifth of the drawing's width, see `round_length`."""
        length = round_length(0.2 * float(self.high[0] - self.low[0]))
        end = EDGE_PT + length * self.points_per_m
        ticks = [((x, x), (y - 2.5, y + 2.5)) for x in (EDGE_PT, end)]
        for xs, ys in (((EDGE_PT, end), (y, y)), *ticks):
            page.add_artist(Line2D(xs, ys, color=self.theme["ink"], linewidth=1.0))
        self._write(page, end + 5.0, y, f"{length:g} m")

    def _keys(self, page: Any, blocks: Sequence[_Block], y: float) -> None:
        for block in blocks:
            for k, key in enumerate(block.keys):
                x = EDGE_PT + block.step * (k // block.rows)
                row = y - LINE_PT * (k % block.rows + 0.5)
                titled = key.form == "title"
                if not titled:
                    self._mark(page, key, x, row)
                room = block.step - (0.0 if titled else HANDLE_PT) - 2.0
                label = fitting(key.label, room, TEXT_PT)
                self._write(page, x + (0.0 if titled else HANDLE_PT), row, label, bold=titled)
            y -= LINE_PT * block.rows + 6.0

    def _write(
        self,
        axes: Any,
        x: float,
        y: float,
        text: str,
        *,
        bold: bool = False,
        size_pt: float = TEXT_PT,
        ha: str = "left",
        va: str = "center_baseline",
    ) -> None:
        axes.text(
            x,
            y,
            text,
            ha=ha,
            va=va,
            fontsize=size_pt,
            fontweight="bold" if bold else "normal",
            color=self.theme["ink"],
            zorder=Order.WORDS,
            parse_math=False,  # run names may hold dollar signs
            fontfamily="sans-serif",
        )

    def _mark(self, page: Any, key: Key, x: float, y: float) -> None:
        middle = x + 0.4 * HANDLE_PT
        if key.form in ("line", "wide line", "stub"):
            half = 3.0 if key.form == "stub" else 0.32 * HANDLE_PT
            width = {"line": 2.0, "wide line": 4.0, "stub": 1.5}[key.form]
            mark = Line2D((middle - half, middle + half), (y, y), color=key.colour, linewidth=width)
        else:
            size = {"dot": 5.0, "big dot": 7.5, "ring": 7.0}[key.form]
            at = np.array([(middle, y)])
            mark = self._markers(at, key.colour, size, ring=key.form == "ring")
        page.add_artist(mark)

    def as_bytes(self, form: Format) -> bytes:
        """The finished drawing as a file; deterministic."""
        out = io.BytesIO()
        with rc_context(), warnings.catch_warnings():
            rcdefaults()  # independent of the user's and the process's settings
            rcParams.update(_STYLE)
            # Glyphs that the font of a PNG lacks are drawn as boxes.
            warnings.filterwarnings("ignore", message="Glyph .* missing from")
            if form == "png":
                self.figure.set_dpi(PNG_DPI)
                agg: Any = FigureCanvasAgg(self.figure)
                agg.print_png(out, metadata={"Software": "topobatch"})
                return out.getvalue()
            vector: Any = FigureCanvasSVG(self.figure)
            vector.print_svg(out, metadata={"Date": None, "Creator": "topobatch"})
        return self._tidied(out.getvalue())

    def _tidied(self, svg: bytes) -> bytes:
        """The SVG with tooltips and numbers rounded to two decimals."""
        ET.register_namespace("", _SVG)
        ET.register_namespace("xlink", _XLINK)
        root = ET.fromstring(svg)
        for about in root.findall(f"{{{_SVG}}}metadata"):
            root.remove(about)
        for node in root.iter():
            for name in _NUMBERS:
                if name in node.attrib:
                    node.set(name, _NUMBER.sub(_two_decimals, " ".join(node.attrib[name].split())))
            told = self._titles.get(node.get("id", ""))
            if told is not None:
                title = ET.Element(f"{{{_SVG}}}title")
                title.text = legible(told)
                node.insert(0, title)
        text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
        return text + b"\n"


_NUMBER = re.compile(r"-?\d+\.\d+")


def _two_decimals(found: re.Match[str]) -> str:
    return f"{float(found[0]) + 0.0:.2f}".rstrip("0").rstrip(".")


def width_of(text: str, size_pt: float) -> float:
    """Estimated width of a text [points]."""
    return size_pt * sum(1.0 if unicodedata.east_asian_width(c) in "WF" else LETTER for c in text)


def fitting(text: str, room_pt: float, size_pt: float) -> str:
    """The text, shortened in the middle to at most `room_pt`; "" if not even that fits."""
    text = legible(text)
    if width_of(text, size_pt) <= room_pt:
        return text
    most = floor(room_pt / (LETTER * size_pt)) - 1
    while most > 1:
        half = most // 2
        short = f"{text[: most - half]}…{text[len(text) - half :]}"
        if width_of(short, size_pt) <= room_pt:
            return short
        most -= 1
    return ""


def folded(text: str, room_pt: float, size_pt: float) -> list[str]:
    """The text wrapped into lines of at most `room_pt`."""
    lines: list[str] = []
    line = ""
    for word in legible(text).split():
        longer = f"{line} {word}" if line else word
        if line and width_of(longer, size_pt) > room_pt:
            lines.append(line)
            longer = word
        line = fitting(longer, room_pt, size_pt)
    return [*lines, line] if line else lines


def round_length(most_m: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is at most `most_m` [m]."""
    unit = 10.0 ** floor(log10(max(most_m, 1e-3)))
    return unit * max(
        step for step in (1.0, 2.0, 5.0) if step * unit <= most_m * (1 + 1e-9) or step == 1
    )


def _columns(keys: Sequence[Key], room_pt: float) -> _Block:
    """The layout with as many columns as the longest label allows; a column takes at most half of
    the page."""
    longest = max(width_of(legible(key.label), TEXT_PT) for key in keys)
    step = min(longest + HANDLE_PT + GAP_PT, room_pt / 2)
    columns = max(1, floor(room_pt / step))
    return _Block(keys, step, ceil(len(keys) / columns))
