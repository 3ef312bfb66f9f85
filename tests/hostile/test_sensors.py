"""A few of the hostile scans, clouds, grids and saved maps, read in this process."""

from __future__ import annotations

import random

import logs_sensors
import numpy as np
import pytest

from topobatch.ingest.grid_map import lattice, map_of_grid
from topobatch.ingest.logs.grids import GridLog
from topobatch.ingest.logs.recording import recording_at
from topobatch.ingest.reading import read_log
from topobatch.ingest.scans.slicing import mount_of_camera
from topobatch.ingest.scans.stream import Mounting, ScanStream
from topobatch.topology.errors import LogError
from topobatch.topology.run import Grid

STREAMED = sorted(name for name in logs_sensors.CASES if name.startswith(("scan-", "cloud-")))
READ = ("map-saved", "tf-frames", "odometry-absurd", "clock-wild")


@pytest.mark.parametrize("name", STREAMED)
def test_every_message_is_given_out_or_counted(tmp_path, name):
    case = logs_sensors.CASES[name](random.Random(1), tmp_path)
    stream = ScanStream(recording_at(case.log), "/sensor", Mounting({}, mount_of_camera))
    scans = sum(len(batch) for batch in stream)
    tally = stream.tally
    assert scans == tally.scans
    assert tally.messages == scans + tally.failed + tally.left_out.total()
    assert scans == tally.messages or tally.warnings("/sensor")


@pytest.mark.parametrize("name", READ)
def test_what_cannot_be_read_is_an_error_of_one_line(tmp_path, name):
    case = logs_sensors.CASES[name](random.Random(1), tmp_path)
    said = ""
    try:
        read_log(case.log)
    except LogError as error:
        said = str(error)
    assert not said or (str(case.log) in said and len(said.splitlines()) == 1)


def cross(cells: int, resolution: float) -> Grid:
    """Two ways of 2 m that cross in the middle of a square."""
    free = np.zeros((cells, cells), bool)
    half, middle = round(1 / resolution), cells // 2
    free[middle - half : middle + half, 20:-20] = True
    free[20:-20, middle - half : middle + half] = True
    return Grid(free, np.zeros_like(free), resolution, (0.0, 0.0, 0.0))


def test_fine_cells_are_joined_before_they_are_mapped():
    large = cross(2500, 0.01)
    grid, told = lattice(large)
    assert grid.free.shape == (500, 500)
    assert grid.resolution_m == pytest.approx(0.05)
    assert not told
    (found,) = map_of_grid(GridLog("run", large, {})).xy[:1]
    small = map_of_grid(GridLog("run", cross(250, 0.1), {}))
    assert np.hypot(*(found - small.xy[0])) < 0.2


@pytest.mark.slow
def test_open_space_without_end_is_one_place_soon():
    """With specks, which are filled before it is thinned, in larger cells."""
    free = np.ones((1500, 1500), bool)
    free[::21, ::21] = False
    assert map_of_grid(GridLog("run", Grid(free, ~free, 0.05, (0.0, 0.0, 0.0)), {})).kind == (
        "room",
    )
