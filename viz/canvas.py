"""A matplotlib page with a drawing in metres, a heading above it, a scale bar and a key below it.

matplotlib is imported by this module. Sizes on the page are in points (1/72 inch).
"""

from __future__ import annotations

import io
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import floor, inf
from textwrap import wrap
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context, rcdefaults, rcParams
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from ..merge.decision_text import short
from ..topology.arrays import FloatArray
from ..topology.run import Grid
from ..topology.wording import legible
from .geometry import PENS, Marker
from .palette import LARGE, MEDIUM, RING, SMALL, THIN, Colour, Theme
from .surface import Look

Format = Literal["svg", "png"]

MARKERS: Mapping[Marker, str] = MappingProxyType(
    {"circle": "o", "triangle": "^", "square": "s", "diamond": "D"}
)
"""Shapes by the names that matplotlib has for them."""

POINTS_PER_INCH = 72.0
WIDTH_PT = 720.0
PEN_PT = 2.0
"""Largest width of a corridor's line, the unit of all marks."""

TEXT_PT, SMALL_PT, HEADING_PT = 8.0, 6.5, 11.0
LINE_PT = 1.5 * TEXT_PT
"""Line spacing of text. The page's margin and the gaps between columns of the key are as wide; the
scale bar, and the sample mark of an entry of the key, have twice as much room."""

LETTER = 0.62
"""Estimated width of a letter over the font size."""

TALLEST = 1.5
"""Largest ratio of height to width of the drawing; a taller one is scaled down to it."""

AROUND = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1)])
FARTHER = (1.0, 1.5, 2.0)
"""Directions in which a text may stand from what it names, and how much farther away, off other
texts. The first ones are between corridors, which run along the axes in most maps."""

MOST_TIPS = 3000
"""Of more marks the others have no tooltips."""

PNG_DPI = 150
"""Resolution of a PNG [pixels per inch]."""

_STYLE: dict[Any, Any] = {
    # A fixed salt makes the ids of clip paths and markers, and so the file, deterministic.
    "svg.hashsalt": "topobatch",
    # Text is written as text, not as outlines: it can be searched, copied and read aloud.
    "svg.fonttype": "none",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "path.simplify": False,
    "text.parse_math": False,
}
_SVG = "http://www.w3.org/2000/svg"
_XLINK = "http://www.w3.org/1999/xlink"


@dataclass(slots=True)
class Canvas:
    """A drawing of the rectangle between two corners, `low` and `high`, (2,) each [m].

    usual_m: length of a usual corridor, of which a pen is a small share; width_pt: width of the
    whole page. What is drawn later lies above. Text may hold any characters: `legible` replaces
    unprintable ones, and what is too long is shortened. What is drawn with a `key` is an entry of
    the key below the drawing: a sample of the mark, and this label.
    """

    low: FloatArray
    high: FloatArray
    theme: Theme
    usual_m: float = inf
    width_pt: float = WIDTH_PT
    name: str = "drawing"
    figure: Figure = field(init=False)
    _axes: Any = field(init=False)
    _titles: dict[str, str] = field(init=False, default_factory=dict)
    _marks: dict[str, Line2D] = field(init=False, default_factory=dict)
    _written: list[FloatArray] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        # The figure is the drawing; the page is what holds it with all texts around it.
        width, height = self._size_pt
        self.figure = Figure((width / POINTS_PER_INCH, height / POINTS_PER_INCH))
        self._axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        self._axes.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]))

    @property
    def _room_pt(self) -> float:
        return self.width_pt - 2 * LINE_PT

    @property
    def _size_pt(self) -> tuple[float, float]:
        """Width and height of the drawing in metres, on the page [points]."""
        width, height = np.maximum(self.high - self.low, 1e-6).tolist()
        scale = min(self._room_pt / width, TALLEST * self._room_pt / height)
        return scale * width, scale * height

    @property
    def points_per_m(self) -> float:
        """Scale of the drawing."""
        return float(self._size_pt[0] / max(float(self.high[0] - self.low[0]), 1e-6))

    @property
    def pen_m(self) -> float:
        """Width of a corridor's line [m]."""
        return self._pen_pt / self.points_per_m

    @property
    def _pen_pt(self) -> float:
        return min(PEN_PT, self.points_per_m * self.usual_m / PENS)

    def lines(self, paths: Sequence[FloatArray], look: Look) -> None:
        """Draw polylines, (k, 2) each [m], with tooltips in an SVG."""
        for rows, own in self._told_apart(len(paths), look.tips):
            self._note(look.key, _line(look.colour, PEN_PT * min(max(look.pens, 1.0), MEDIUM)))
            drawn = PathPatch(
                Path.make_compound_path(*(Path(paths[k]) for k in rows)),
                facecolor="none",
                edgecolor=look.colour,
                linewidth=look.pens * self._pen_pt,
                capstyle="round",
                joinstyle="round",
            )
            self._add(drawn, own)

    def _told_apart(
        self, count: int, tips: Sequence[str]
    ) -> Iterator[tuple[Sequence[int], Sequence[str]]]:
        """Rows drawn in one piece, with their tooltip: each by itself where each has one."""
        if 1 < len(tips) <= MOST_TIPS - len(self._titles):
            yield from (([k], tips[k : k + 1]) for k in range(count))
        elif count:
            yield range(count), tips if len(tips) == 1 else ()

    def dots(self, xy: FloatArray, look: Look) -> None:
        """Draw filled marks, or rings, at xy (n, 2) [m]."""
        for rows, own in self._told_apart(len(xy), look.tips):
            self._note(look.key, self._markers(xy[:0], look, min(look.pens, LARGE), PEN_PT))
            self._add(self._markers(xy[rows], look, look.pens, self._pen_pt), own)

    def _note(self, key: str, sample: Line2D) -> None:
        """Add an entry to the key, unless there is one of this name."""
        if key:
            self._marks.setdefault(key, sample)

    def _markers(self, xy: FloatArray, look: Look, pens: float, pen_pt: float) -> Line2D:
        """Marks at xy (n, 2) [m]."""
        return Line2D(
            xy[:, 0],
            xy[:, 1],
            linestyle="none",
            marker=MARKERS[look.marker],
            markersize=pens * pen_pt,
            markerfacecolor="none" if look.ring else look.colour,
            markeredgecolor=look.colour if look.ring else self.theme["paper"],
            markeredgewidth=THIN * pen_pt,
        )

    def cells(self, grid: Grid, look: Look, alpha: float = 1.0) -> None:
        """Draw the occupied cells of a grid that lies along the axes."""
        self._note(look.key, _line(look.colour, SMALL * PEN_PT))
        pixels = np.zeros((*grid.free.shape, 4))
        pixels[~grid.free & ~grid.unknown] = (*to_rgb(look.colour), alpha)
        x, y, _ = grid.origin
        high, wide = (count * grid.resolution_m for count in grid.free.shape)
        picture = self._axes.imshow(
            pixels,
            origin="lower",
            extent=(x, x + wide, y, y + high),
            aspect="auto",
            interpolation="none",
            zorder=len(self._axes.get_children()),
        )
        picture.set_clip_on(False)
        # What is drawn as a picture must not move the corners.
        self._axes.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]))

    def words(
        self, xy: FloatArray, texts: Sequence[str], *, bold: bool = False, ink: Colour = ""
    ) -> None:
        """Write a text beside each of the points (n, 2) [m] that they name, off other texts. ink:
        its colour, by default that of all text."""
        size_pt = TEXT_PT if bold else SMALL_PT
        for at, text in zip(xy, map(legible, texts), strict=True):
            half = self._half(text, size_pt)
            aside = np.sign(AROUND) * half + AROUND * RING / 2 * self.pen_m
            places = np.concatenate([at + far * aside for far in FARTHER])
            written = np.reshape(self._written, (-1, 4))
            off = np.abs(places[:, None] - written[:, :2]) - half - written[:, 2:]
            over = np.maximum(-off.max(axis=-1), 0.0).sum(axis=1)
            self._write(places[int(over.argmin())], text, size_pt, bold=bold, ink=ink)

    def title(self, top: FloatArray, text: str) -> None:
        """Write a text below a point (2,) [m]."""
        self._write(top - np.array([0.0, TEXT_PT / self.points_per_m]), legible(text), TEXT_PT)

    def _half(self, text: str, size_pt: float) -> FloatArray:
        """Half the width and height of a text, about (2,) [m]."""
        sides_pt = np.array([LETTER * size_pt * len(text), size_pt])
        return np.asarray(sides_pt / (2 * self.points_per_m))

    def _write(
        self, at: FloatArray, text: str, size_pt: float, *, bold: bool = False, ink: Colour = ""
    ) -> None:
        """Write a text centred at a point (2,) [m]."""
        self._written.append(np.concatenate([at, self._half(text, size_pt)]))
        font = self._font(size_pt, bold=bold)
        if ink or bold:  # what lies below it may have the same one
            box = {"boxstyle": "square,pad=0.1", "fc": self.theme["paper"], "lw": 0, "alpha": 0.7}
            font |= {"color": ink or font["color"], "bbox": box}
        self._axes.text(*at.tolist(), text, ha="center", va="center", **font)

    def _font(self, size_pt: float = TEXT_PT, *, bold: bool = False) -> dict[str, Any]:
        return {
            "fontsize": size_pt,
            "fontweight": "bold" if bold else "normal",
            "fontfamily": "sans-serif",
            "color": self.theme["ink"],
            "zorder": inf,
            "parse_math": False,  # run names may hold dollar signs
        }

    def _add(self, artist: Any, tips: Sequence[str] = ()) -> None:
        """Draw an artist above the others, also beyond the corners; one tip becomes its tooltip."""
        artist.set_clip_on(False)
        artist.set_zorder(len(self._axes.get_children()))
        if len(tips) == 1:
            gid = f"{self.name}-{len(self._titles)}"
            artist.set_gid(gid)
            (self._titles[gid],) = tips
        self._axes.add_artist(artist)

    def finish(self, heading: Sequence[str]) -> None:
        """Write what stands around the drawing: heading lines above (empty ones are skipped; the
        first one is larger), a scale bar and the key below."""
        with _styled():
            self._write_heading(*map(legible, heading))
            self._draw_scale_bar()
            if self._marks:
                self._draw_key()

    def _write_heading(self, title: str, *others: str) -> None:
        """Write the title and lines below it, upwards from the drawing's upper edge."""
        room = letters(self._room_pt, TEXT_PT)
        lines = [(line, self._font()) for text in others for line in wrap(text, room)]
        title = short(title, letters(self._room_pt, HEADING_PT))
        lines = [(title, self._font(HEADING_PT, bold=True)), *lines]
        for k, (line, font) in enumerate(reversed(lines)):
            above = self._below(-TEXT_PT - k * LINE_PT)
            self._axes.text(0.0, 1.0, line, va="bottom", transform=above, **font)

    def _draw_scale_bar(self) -> None:
        wide = float(self.high[0] - self.low[0])
        length = float(MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0.0, wide)[1])
        bar = AnchoredSizeBar(
            self._axes.transData,
            length,
            f"{length:g} m",
            "upper left",
            frameon=False,
            borderpad=0.0,
            color=self.theme["ink"],
            fontproperties=FontProperties(size=TEXT_PT),
            bbox_to_anchor=(0.0, 0.0),
            bbox_transform=self._below(TEXT_PT / 2),
        )
        self._add(bar)

    def _draw_key(self) -> None:
        """Draw samples of marks and lines with their labels, in as many columns as fit."""
        longest = max(map(len, self._marks))
        columns = max(1, floor(self._room_pt / (LETTER * TEXT_PT * longest + 3 * LINE_PT)))
        most = letters(self._room_pt / columns - 3 * LINE_PT, TEXT_PT)
        legend = self._axes.legend(
            [*self._marks.values()],
            [short(legible(label), most) for label in self._marks],
            loc="upper left",
            bbox_to_anchor=(0.0, 0.0),
            bbox_transform=self._below(2 * LINE_PT),
            ncols=columns,
            frameon=False,
            fontsize=TEXT_PT,
            labelcolor=self.theme["ink"],
            labelspacing=LINE_PT / TEXT_PT - 1,
            borderpad=0.0,
            borderaxespad=0.0,
        )
        self._add(legend)

    def _below(self, down_pt: float) -> Any:
        """The transform of the drawing's fractions, moved down the page."""
        down = ScaledTranslation(0.0, -down_pt / POINTS_PER_INCH, self.figure.dpi_scale_trans)
        return self._axes.transAxes + down

    def as_bytes(self, form: Format) -> bytes:
        """The finished drawing as a file; deterministic."""
        out = io.BytesIO()
        about = {"Software": "topobatch"} if form == "png" else {"Date": None, "Creator": None}
        with _styled(), warnings.catch_warnings():
            # Glyphs that the font of a PNG lacks are drawn as boxes.
            warnings.filterwarnings("ignore", message="Glyph .* missing from")
            self.figure.savefig(
                out,
                format=form,
                dpi=PNG_DPI,
                metadata=about,
                facecolor=self.theme["paper"],
                bbox_inches="tight",
                pad_inches=LINE_PT / POINTS_PER_INCH,
            )
        return out.getvalue() if form == "png" else self._tidied(out.getvalue())

    def _tidied(self, svg: bytes) -> bytes:
        """The SVG with tooltips, its numbers rounded to two decimals, without indentation."""
        ET.register_namespace("", _SVG)
        ET.register_namespace("xlink", _XLINK)
        root = ET.fromstring(svg)
        for about in root.findall(f"{{{_SVG}}}metadata"):
            root.remove(about)
        for node in root.iter():
            node.text, node.tail = ((text or "").strip() for text in (node.text, node.tail))
            for name in _NUMBERS & node.attrib.keys():
                numbers = _NUMBER.sub(_two_decimals, " ".join(node.attrib[name].split()))
                node.set(name, numbers)
            tip = self._titles.get(node.get("id", ""))
            if tip is not None:
                title = ET.Element(f"{{{_SVG}}}title")
                title.text = legible(tip)
                node.insert(0, title)
        text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
        return text + b"\n"


_NUMBERS = {"d", "x", "y", "transform", "width", "height", "viewBox"}
"""SVG attributes whose numbers are rounded."""
_NUMBER = re.compile(r"-?\d+\.\d+")


def _two_decimals(found: re.Match[str]) -> str:
    return f"{float(found[0]) + 0.0:.2f}".rstrip("0").rstrip(".")


@contextmanager
def _styled() -> Iterator[None]:
    """Our style, independent of the user's and the process's settings."""
    with rc_context():
        rcdefaults()
        rcParams.update(_STYLE)
        yield


def _line(colour: str, width_pt: float) -> Line2D:
    """The sample of a line in the key."""
    return Line2D([], [], color=colour, linewidth=width_pt)


def letters(room_pt: float, size_pt: float) -> int:
    """About how many letters have room, at least one."""
    return max(floor(room_pt / (LETTER * size_pt)), 1)
