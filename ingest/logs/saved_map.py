"""Maps saved by ROS's map_server: `map.yaml` beside an image of the grid.

Only the YAML that map savers write is supported: `key: value`, lists in brackets or with dashes.
"""

from __future__ import annotations

import re
import struct
import warnings
from pathlib import Path
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray
from ...topology.errors import LogError
from ...topology.run import Grid
from ..remote.path import LogPath, RemotePath
from .messages import printable

YAML_BYTES = 1 << 16
"""Largest description that is read; real ones have 200 bytes."""

IMAGE_FORMATS = ("PPM", "PNG", "BMP")
"""Image formats of map savers by Pillow's names; its PPM includes PGM."""

_LINE = re.compile(r"^(?P<key>[A-Za-z_]+)\s*:\s*(?P<value>.*?)\s*(#.*)?$")
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
        found = _keys(_text(path))
    except (OSError, ValueError):
        return False
    return {"image", "resolution", "origin"} <= set(found)


def saved_map_files(path: Path) -> tuple[Path, ...]:
    """The description and the image; LogError if there is no image."""
    try:
        image = path.parent / _image(_keys(_text(path)))
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: {error}") from error
    try:
        there = image.is_file()
    except (OSError, ValueError):
        there = False
    if not there:
        raise LogError(f"{path}: its image {printable(str(image))[:200]} is missing")
    return path, image


def read_saved_map(path: Path) -> Grid:
    """The grid of a saved map; raises LogError if it cannot be read."""
    _, image = saved_map_files(path)
    try:
        found = _keys(_text(path))
        free, unknown = _cells(_pixels(image), found)
        x, y, yaw = [float(v) for v in (*found["origin"], "0")[:3]]
        resolution = _number(found, "resolution")
        grid = Grid(free[::-1], unknown[::-1], resolution, (x, y, yaw))
        return checked_grid(grid)
    except (ValueError, KeyError, OSError) as error:
        text = printable(" ".join(str(error).split()))[:200]
        raise LogError(f"{path}: is no map that can be read: {text}") from error


def _text(path: Path) -> str:
    with path.open("rb") as file:
        raw = file.read(YAML_BYTES + 1)
    if len(raw) > YAML_BYTES:
        raise ValueError("the description is implausibly long")
    return raw.decode("utf-8", "replace")


def _keys(text: str) -> dict[str, list[str]]:
    """Values by key, as lists."""
    out: dict[str, list[str]] = {}
    last: list[str] | None = None
    for line in text.splitlines():
        item = re.match(r"^\s*-\s+(.*?)\s*(#.*)?$", line)
        if item and last is not None:
            last.append(item[1].strip("\"'"))
            continue
        match = _LINE.match(line)
        if match is None:
            continue
        value = match["value"].strip()
        inner = value[1:-1].split(",") if value.startswith("[") else [value] if value else []
        last = out[match["key"]] = [part.strip().strip("\"'") for part in inner]
    return out


def _image(found: dict[str, list[str]]) -> str:
    if not found.get("image"):
        raise ValueError("it names no image")
    return found["image"][0]


def _number(found: dict[str, list[str]], key: str, otherwise: float | None = None) -> float:
    values = found.get(key)
    if not values:
        if otherwise is None:
            raise ValueError(f"it has no {key}")
        return otherwise
    return float(values[0])


def _pixels(path: Path) -> NDArray[np.uint8]:
    """(h, w, 2) brightness (0 black to 255 white) and opacity of every pixel.

    The size is checked before decoding. Raises ValueError for invalid images.
    """
    from PIL import Image

    bombs = (Image.DecompressionBombError, Image.DecompressionBombWarning)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(path, formats=IMAGE_FORMATS)
        with image:
            if image.width * image.height > MOST_CELLS:
                raise ValueError(f"a picture of {image.width} x {image.height} is too large")
            if image.mode.startswith(("I", "F")):
                # 16-bit images are reduced to 8 bits.
                shades = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
                return np.stack([shades, np.full_like(shades, 255)], axis=-1)
            return np.asarray(image.convert("LA"))
    # Pillow raises these on invalid data.
    except (OSError, SyntaxError, EOFError, struct.error, MemoryError, *bombs) as error:
        raise ValueError(f"{path.name} is no picture that can be read") from error


def _cells(pixels: NDArray[np.uint8], found: dict[str, list[str]]) -> tuple[BoolArray, BoolArray]:
    """(h, w) which pixels are free, and which unknown, by map_server's rules."""
    mode = (found.get("mode") or ["trinary"])[0]
    if mode not in ("trinary", "scale", "raw"):
        raise ValueError(f"its mode is {mode!r}, expected trinary, scale or raw")
    least, most = _number(found, "free_thresh", 0.196), _number(found, "occupied_thresh", 0.65)
    shade = np.arange(256)
    if mode == "raw":
        # Pixels are occupancies, 0 to 100, larger for unknown.
        free, unknown = shade <= 100 * least, shade > 100
    else:
        occupied = shade if _number(found, "negate", 0) else 255 - shade
        free = occupied < 255 * least
        unknown = ~free & (occupied <= 255 * most)
    seen = (pixels[..., 1] == 255) | (mode == "trinary")
    return free[pixels[..., 0]] & seen, unknown[pixels[..., 0]] | ~seen
