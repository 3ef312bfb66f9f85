"""Scans read again and laid onto the map of their run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.ingest.reading import ReadSettings, read_run
from topobatch.ingest.run_scans import scans_on_map
from topobatch.topology.errors import DataError
from topobatch.topology.se2 import apply, compose

SAMPLES = Path(__file__).parents[2] / "sample_logs"
OFFICE = SAMPLES / "office-1.mcap"


def test_scans_lie_where_the_views_of_the_map_do() -> None:
    topomap = build_map(read_run(OFFICE))
    found = scans_on_map(OFFICE, ReadSettings(), topomap)
    assert len(found.body) == len(found.keyframes) > 100
    # The robot was at the places of the views, up to their raster.
    at = np.searchsorted(found.keyframes.time_ns, topomap.views.time_ns)
    away = np.hypot(*(found.body[at, :2] - topomap.views.pose[:, :2]).T)
    assert away.max() < 0.6
    T = np.array([4.0, -2.0, 1.0])
    views = replace(topomap.views, pose=compose(T, topomap.views.pose))
    moved = scans_on_map(OFFICE, ReadSettings(), replace(topomap, views=views))
    assert moved.body[:, :2] == pytest.approx(apply(T, found.body[:, :2]), abs=1e-6)
    late = replace(topomap.views, time_ns=topomap.views.time_ns + 1)
    with pytest.raises(DataError, match="not those that the map of run office-1 was made from"):
        scans_on_map(OFFICE, ReadSettings(), replace(topomap, views=late))
    with pytest.raises(DataError, match="holds no scans"):
        scans_on_map(SAMPLES / "maze-1.mcap", ReadSettings(), topomap)
