"""An occupancy grid below a map: the one that it was made from, or the walls of a site.

Written as an image with a transform: rerun's `GridMap` is not drawn in 2D views.
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
"""Largest image side that every graphics card takes; larger grids are reduced."""


def write_grid(recording: Recording, path: PathParts, grid: Grid) -> None:
    """Write a grid as occupied, free and unknown cells."""
    shade = np.full(grid.free.shape, 2, np.uint8)
    shade[grid.unknown] = 0
    shade[grid.free] = 1
    step = -(-max(shade.shape) // MOST_PIXELS)
    for axis in (0, 1):
        # A reduced cell is occupied if any of its cells is.
        starts = np.arange(0, shade.shape[axis], step)
        shade = np.maximum.reduceat(shade, starts, axis=axis)
    picture = Image.fromarray(shade)
    picture.putpalette([*palette.BACKGROUND, *palette.UNLIT, *palette.WALL])
    png = BytesIO()
    picture.convert("RGB").save(png, "PNG")
    x, y, yaw = grid.origin
    recording.static(
        path,
        rr.Transform3D(
            translation=[x, y, 0.0],
            rotation=rr.RotationAxisAngle([0, 0, 1], radians=yaw),
            scale=grid.resolution_m * step,
        ),
        rr.EncodedImage(
            contents=png.getvalue(), media_type="image/png", draw_order=palette.Order.GRID
        ),
    )
