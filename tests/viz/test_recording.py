"""The grid that a map was made from, under the map."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from topobatch.topology.run import Grid
from topobatch.viz.map_recording import write_map_recording
from topobatch.viz.palette import DARK, rgb

from .readback import Readback


def picture(recording: Readback) -> np.ndarray:
    (blob,) = recording.value("/map/grid", "EncodedImage:blob")
    return np.asarray(Image.open(BytesIO(bytes(blob))))


@pytest.fixture
def grid() -> Grid:
    free = np.zeros((4, 6), bool)
    free[1:3, 1:5] = True
    unknown = np.zeros_like(free)
    unknown[3] = True
    return Grid(free, unknown, 0.5, (3.0, -2.0, 0.25))


def test_the_grid_lies_where_its_origin_says(make_map, grid, tmp_path: Path) -> None:
    write_map_recording(tmp_path / "a.rrd", make_map("floor"), grid=grid)
    drawn = Readback(tmp_path / "a.rrd")
    shown = picture(drawn)
    # Row 0 at the least y: the view mirrors the picture with the map.
    assert shown.shape == (4, 6, 3)
    assert (shown[1:3, 1:5] == rgb(DARK["unlit"])).all()
    assert (shown[3] == rgb(DARK.paper)).all()
    assert (shown[0] == rgb(DARK["wall"])).all()
    assert drawn.value("/map/grid", "Transform3D:translation") == [[3.0, -2.0, 0.0]]
    assert drawn.value("/map/grid", "Transform3D:scale") == [[0.5] * 3]
    write_map_recording(tmp_path / "b.rrd", make_map("run"))
    without = Readback(tmp_path / "b.rrd")
    assert "/map/grid" not in without.entities
