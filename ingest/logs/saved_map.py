"""Maps saved by ROS's map_server: `map.yaml` beside an image of the grid."""

from __future__ import annotations

import re
import struct
from contextlib import suppress
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, TypeGuard

import numpy as np

from ...topology.arrays import BoolArray, IntArray
from ...topology.errors import LogError
from ...topology.run import Grid
from ...topology.wording import legible
from ..remote.path import LogPath, RemotePath
from .messages import one_line
from .metadata import yaml_values

if TYPE_CHECKING:
    from PIL.Image import Image

YAML_BYTES = 1 << 16
"""Largest description that is read; real ones have 200 bytes."""

IMAGE_FORMATS = ("PPM", "PNG", "BMP", "JPEG")
"""Image formats by Pillow's names: those of map savers (its PPM includes PGM), and that of photos
and plans."""

MOST_PIXELS = 1 << 26
"""Largest picture that is decoded: 67 million shades of grey, of a byte each, or half as many
others. With it, reading takes less than 300 MB."""

SAVED_UNKNOWN = 50
"""Occupancy of unknown cells, of 255, as map savers write them: shade 205."""

LOSSY_SHADES = 5
"""How far a JPEG's shades lie from those that were saved (of a saved map of quality 75 to 95)."""

USUAL_FREE_THRESH = 0.196
"""By which such cells are unknown: map_server's default."""

_NAMED = re.compile(r"\.ya?ml$", re.IGNORECASE)


MOST_CELLS = 1 << 24
"""Largest grid that is read: 16.8 million cells, 200 by 200 m at 5 cm."""


def checked_grid(grid: Grid) -> Grid:
    """The grid; raises ValueError if its numbers are invalid."""
    height, width = grid.free.shape
    if height * width == 0 or height * width > MOST_CELLS:
        raise ValueError(f"a grid of {width} x {height} cells cannot be read")
    if not 1e-3 <= grid.resolution_m <= 10:
        raise ValueError(f"its resolution is {grid.resolution_m} m, expected 0.001 to 10")
    if not (np.isfinite(grid.origin).all() and max(map(abs, grid.origin)) < 1e6):
        raise ValueError(f"its origin {grid.origin} is no place")
    return grid


def is_saved_map(path: LogPath) -> TypeGuard[Path]:
    """Whether a local file describes a saved map, by its name and keys."""
    if isinstance(path, RemotePath) or not _NAMED.search(path.name) or not path.is_file():
        return False
    try:
        found = yaml_values(_text(path))
    except (OSError, ValueError):
        return False
    return {"image", "resolution", "origin"} <= set(found)


def saved_map_files(path: Path) -> tuple[Path, ...]:
    """The description and the image: where it says or, for a path of another computer, one of that
    name beside it. LogError if there is none."""
    try:
        named = _image(yaml_values(_text(path)))
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: {error}") from error
    image = path.parent / named
    for place in (image, path.parent / PureWindowsPath(named).name):
        with suppress(OSError, ValueError):
            if place.is_file():
                return path, place
    raise LogError(f"{path}: its image {legible(str(image))[:200]} is missing")


def read_saved_map(path: Path) -> tuple[Grid, tuple[str, ...]]:
    """The grid of a saved map, of more than MOST_CELLS in larger cells, and what was read otherwise
    than it is written; raises LogError if it cannot be read."""
    _, image = saved_map_files(path)
    try:
        found = yaml_values(_text(path))
        origin = [float(v) for v in (*found["origin"], "0")[:3]]
        if len(origin) < 3:
            raise ValueError("its origin is not x, y and yaw")
        x, y, yaw = origin
        like = Grid(_NONE, _NONE, _number(found, "resolution"), (x, y, yaw))
        grid, notes = _read(image, found, like)
        if not (path.parent / _image(found)).is_file():
            where = legible(_image(found))[:200]
            notes = (f"its image {where} is not there; {image.name} beside it is read", *notes)
        return checked_grid(grid), notes
    except (ValueError, KeyError, OSError) as error:
        raise LogError(f"{path}: is no map that can be read: {one_line(error)}") from error


_NONE = np.zeros((0, 0), bool)


def _text(path: Path) -> str:
    with path.open("rb") as file:
        raw = file.read(YAML_BYTES + 1)
    if len(raw) > YAML_BYTES:
        raise ValueError("the description is implausibly long")
    return raw.decode("utf-8", "replace")


def _image(found: dict[str, list[str]]) -> str:
    if not found.get("image"):
        raise ValueError("it names no image")
    return found["image"][0]


_WORDS = {"true": 1.0, "yes": 1.0, "on": 1.0, "false": 0.0, "no": 0.0, "off": 0.0}
"""YAML's truth values."""


def _number(found: dict[str, list[str]], key: str, otherwise: float | None = None) -> float:
    values = found.get(key)
    if not values:
        if otherwise is None:
            raise ValueError(f"it has no {key}")
        return otherwise
    word = _WORDS.get(values[0].lower())
    try:
        return float(values[0]) if word is None else word
    except ValueError:
        raise ValueError(f"its {key} is {values[0]!r}, not a number") from None


def _read(path: Path, found: dict[str, list[str]], like: Grid) -> tuple[Grid, tuple[str, ...]]:
    """A picture as a grid like one, and what is to be told; its size is checked before it is
    decoded. Raises ValueError for invalid pictures."""
    from PIL import Image

    mode = (found.get("mode") or ["trinary"])[0].lower()
    known = Image.MAX_IMAGE_PIXELS
    try:
        Image.MAX_IMAGE_PIXELS = None  # the limit of our own is by memory
        with Image.open(path, formats=IMAGE_FORMATS) as image:
            image.draft("L", None)  # a JPEG in colours is decoded in shades of grey
            _check_size(image)
            grey, lossy = _grey(image), image.format == "JPEG"
            transparent = mode != "trinary" and image.has_transparency_data
            alpha = image.convert("LA").getchannel("A") if transparent else None
    # Pillow raises these on invalid data.
    except (OSError, SyntaxError, EOFError, struct.error, MemoryError) as error:
        formats = "PGM, PNG, BMP or JPEG"
        raise ValueError(f"{path.name} is no picture that can be read ({formats})") from error
    finally:
        Image.MAX_IMAGE_PIXELS = known
    notes: list[str] = []
    free, unknown = _meanings(found, mode, np.array(grey.histogram()), lossy, notes)
    shade = np.asarray(grey)[::-1]  # the first row has the largest y
    grid = like._replace(free=free[shade], unknown=unknown[shade])
    if alpha is not None:
        seen = np.asarray(alpha)[::-1] == 255
        grid = grid._replace(free=grid.free & seen, unknown=grid.unknown | ~seen)
    factor = 1
    while -(-grey.width // factor) * -(-grey.height // factor) > MOST_CELLS:
        factor += 1
    if factor > 1:
        grid = coarser(grid, factor)
        size = f"{grey.width} x {grey.height}"
        notes.append(
            f"its picture of {size} cells is large; it is read in cells of {grid.resolution_m:g} m"
        )
    return grid, tuple(notes)


def _check_size(image: Image) -> None:
    """ValueError for a picture that takes too much memory."""
    grey = image.mode in ("1", "L", "P")
    most = MOST_PIXELS if grey else MOST_PIXELS // 2
    if image.width * image.height > most:
        more = "" if grey else "; in shades of grey it may be larger"
        raise ValueError(
            f"a picture of {image.width} x {image.height} is too large: {most:,} pixels{more}"
        )


def _grey(image: Image) -> Image:
    """A picture of any kind as shades from 0, black, to 255, white."""
    if image.mode.startswith("I"):  # of 16 bits
        import PIL.Image

        return PIL.Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
    return image.convert("L")


def _meanings(
    found: dict[str, list[str]], mode: str, shades: IntArray, lossy: bool, notes: list[str]
) -> tuple[BoolArray, BoolArray]:
    """(256,) which shades are free, and which unknown, by map_server's rules; shades: the number of
    pixels of each; lossy: they are not exact. What is to be told is added to the notes.

    nav2's map_saver wrote free_thresh 0.25 for years, by which the unknown cells of its own
    pictures are free: a level of theirs below brighter ones stays unknown.
    """
    if mode not in ("trinary", "scale", "raw"):
        raise ValueError(f"its mode is {mode!r}, expected trinary, scale or raw")
    least, most = (
        _number(found, "free_thresh", USUAL_FREE_THRESH),
        _number(found, "occupied_thresh", 0.65),
    )
    shade = np.arange(256)
    if mode == "raw":
        # Pixels are occupancies, 0 to 100, larger for unknown.
        free, unknown = shade <= 100 * least, shade > 100
    else:
        occupied = shade if _number(found, "negate", 0) else 255 - shade
        number = shades[occupied.argsort()]  # by occupancy
        around = slice(SAVED_UNKNOWN - LOSSY_SHADES, SAVED_UNKNOWN + LOSSY_SHADES + 1)
        beside = number[around].sum() - number[SAVED_UNKNOWN]
        level = number[SAVED_UNKNOWN] > beside and number[:SAVED_UNKNOWN].any()
        if level and 255 * least > SAVED_UNKNOWN:
            notes.append(
                f"{number[SAVED_UNKNOWN]:,} cells have shade 205, as which map savers write "
                f"unknown ones, and would be free by its free_thresh of {least:g}; they stay "
                f"unknown, as by {USUAL_FREE_THRESH}"
            )
            least = USUAL_FREE_THRESH
        free = occupied < 255 * least
        if level and lossy:
            free &= occupied < SAVED_UNKNOWN - LOSSY_SHADES
        unknown = ~free & (occupied <= 255 * most)
    if not shades[free].any():
        there = np.flatnonzero(shades)
        notes.append(
            f"no cell is free by its free_thresh of {least:g}: its shades go from {there[0]} to "
            f"{there[-1]} (0 black, 255 white)"
        )
    return free, unknown


def coarser(grid: Grid, factor: int) -> Grid:
    """Blocks of `factor` by `factor` cells as one, smaller at the far edges: free if all are,
    unknown if any is."""
    if factor <= 1:
        return grid
    free, unknown = grid.free, grid.unknown
    for axis in (0, 1):
        free = _joined(free, factor, axis, np.logical_and)
        unknown = _joined(unknown, factor, axis, np.logical_or)
    return grid._replace(free=free, unknown=unknown, resolution_m=factor * grid.resolution_m)


def _joined(cells: BoolArray, factor: int, axis: int, join: np.ufunc) -> BoolArray:
    """Blocks of `factor` rows or columns combined; ten times as fast as numpy's `reduceat`."""
    turned = np.moveaxis(cells, axis, 0)
    out: BoolArray = turned[::factor].copy()
    for k in range(1, min(factor, len(turned))):
        more = turned[k::factor]
        join(out[: len(more)], more, out=out[: len(more)])
    return np.ascontiguousarray(np.moveaxis(out, 0, axis))
