"""The occupancy grid that a map was made from, under the map.

As a picture that is turned and scaled: rerun's `GridMap` is drawn in views of space, not in those
of the plane.
"""

from __future__ import annotations

from io import BytesIO

import numpy as np
import rerun as rr
from PIL import Image

from ..topology.run import Grid
from . import palette
from .recording import PathParts, Recording

MOST_PIXELS = 8192
"""Side of the largest picture that every graphics card takes; larger grids lose cells between."""


def write_grid(recording: Recording, root: PathParts, grid: Grid) -> None:
    """Write the grid below `root`: walls over free space over what is not known."""
    shade = np.full(grid.free.shape, 2, np.uint8)
    shade[grid.unknown] = 0
    shade[grid.free] = 1
    step = -(-max(shade.shape) // MOST_PIXELS)
    for axis in (0, 1):
        # Of cells drawn as one the wall is kept.
        starts = np.arange(0, shade.shape[axis], step)
        shade = np.maximum.reduceat(shade, starts, axis=axis)
    picture = Image.fromarray(shade)
    picture.putpalette([*palette.BACKGROUND, *palette.UNLIT, *palette.WALL])
    png = BytesIO()
    picture.convert("RGB").save(png, "PNG")
    x, y, yaw = grid.origin
    recording.static(
        (*root, "grid"),
        rr.Transform3D(
            translation=[x, y, 0.0],
            rotation=rr.RotationAxisAngle([0, 0, 1], radians=yaw),
            scale=grid.resolution_m * step,
        ),
        rr.EncodedImage(
            contents=png.getvalue(), media_type="image/png", draw_order=palette.Order.GRID
        ),
    )
