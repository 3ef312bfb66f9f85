"""Occupancy grids for ROS's map_server and AMCL: `map.yaml` and a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...topology.run import Grid
from ...topology.wording import legible
from .yaml_lines import yaml_text

WALL, UNKNOWN, FREE = 0, 205, 254
"""Shades of cells, as map savers write them."""


def map_picture(grid: Grid) -> bytes:
    """The cells as a PGM picture, whose first row has the largest y."""
    shades = np.full(grid.free.shape, WALL, np.uint8)
    shades[grid.unknown] = UNKNOWN
    shades[grid.free] = FREE
    width, height = len(shades[0]), len(shades)
    return b"P5\n%d %d\n255\n" % (width, height) + shades[::-1].tobytes()


def map_yaml(grid: Grid, picture: str, remarks: Sequence[str] = ()) -> str:
    """The description of a grid. picture: name of its file; remarks: lines of comment."""
    document = {
        "image": picture,
        "mode": "trinary",
        "resolution": grid.resolution_m,
        "origin": np.round(grid.origin, 6).tolist(),
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    comments = "".join(f"# {legible(remark)}\n" for remark in remarks)
    return comments + yaml_text(document, 1)
