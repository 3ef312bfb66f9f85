"""A few of the hostile scans, clouds, grids and saved maps, read in this process."""

from __future__ import annotations

import random

import logs_sensors
import numpy as np
import pytest

from topobatch.ingest.grid_log import GridLog
from topobatch.ingest.grid_map import MOST_CELLS, lattice, map_of_grid
from topobatch.ingest.logs.clouds import MOST_POINTS, wire_cloud
from topobatch.ingest.logs.messages import DamageError
from topobatch.ingest.logs.recording import recording_at
from topobatch.ingest.reading import ReadSettings, read_log
from topobatch.ingest.scans.slicing import mount_of_camera
from topobatch.ingest.scans.stream import Mounting, ScanStream
from topobatch.topology.errors import DataError, LogError
from topobatch.topology.run import Grid

STREAMED = sorted(
    name
    for name in logs_sensors.CASES
    if name.startswith(("scan-", "cloud-"))
    and name not in ("scan-beams", "cloud-bytes", "cloud-large")
)
READ = ("grid-sizes", "grid-numbers", "map-saved", "tf-frames", "odometry-absurd", "clock-wild")


@pytest.mark.parametrize("name", STREAMED)
@pytest.mark.parametrize("seed", range(3))
def test_every_message_is_given_out_or_counted(tmp_path, name, seed):
    case = logs_sensors.CASES[name](random.Random(seed), tmp_path)
    stream = ScanStream(recording_at(case.log), "/sensor", Mounting({}, mount_of_camera))
    scans = sum(len(batch) for batch in stream)
    tally = stream.tally
    assert scans == tally.scans
    assert tally.messages == scans + tally.failed + tally.left_out.total()
    assert scans == tally.messages or tally.warnings("/sensor")


@pytest.mark.parametrize("name", READ)
@pytest.mark.parametrize("seed", range(3))
def test_what_cannot_be_read_is_an_error_of_one_line(tmp_path, name, seed):
    case = logs_sensors.CASES[name](random.Random(seed), tmp_path)
    said = ""
    try:
        read_log(case.log)
    except LogError as error:
        said = str(error)
    assert not said or (str(case.log) in said and len(said.splitlines()) == 1)


@pytest.mark.parametrize("seed", range(12))
def test_broken_chunks_of_sensors_alone_are_told(tmp_path, seed):
    case = logs_sensors.CASES["sensor-apart"](random.Random(seed), tmp_path)
    try:
        told = read_log(case.log).warnings
    except DataError as error:
        told = (str(error),)
    assert any(case.says in text for text in told)
    with pytest.raises(DataError, match=case.says):
        read_log(case.log, ReadSettings(strict=True))


@pytest.mark.parametrize(
    ("height", "width", "step", "row"),
    [
        (1 << 31, 1 << 31, 0, 0),
        (12, (1 << 31) - 1, 0, 0),
        (1, MOST_POINTS + 1, 0, 0),
        ((1 << 32) - 1, 1, 0, 0),
        (100, 100, 0, 0),
        (2, 10, 12, 0),
    ],
)
def test_clouds_of_points_without_room_take_no_memory(height, width, step, row):
    raw = logs_sensors._cloud(1, bytes(1200), height=height, width=width, step=step, row=row)
    with pytest.raises(DamageError):
        wire_cloud(raw, ros1=False)


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


def test_a_grid_of_too_many_cells_is_mapped_in_larger_ones():
    large = cross(3000, 0.05)
    assert large.free.size > MOST_CELLS
    grid, told = lattice(large)
    assert grid.free.size <= MOST_CELLS
    assert "cells of 0.1 m are taken" in told[0]


@pytest.mark.parametrize("every", [3000, 21])
def test_open_space_without_end_is_refused_soon(every: int):
    """With or without specks, which are filled before it is thinned, in larger cells."""
    free = np.ones((1500, 1500), bool)
    free[::every, ::every] = False
    with pytest.raises(DataError, match="shows no junction"):
        map_of_grid(GridLog("run", Grid(free, ~free, 0.05, (0.0, 0.0, 0.0)), {}))


def test_noise_is_refused_before_its_ways_are_counted_against_each_other():
    free = np.random.default_rng(1).random((600, 600)) < 0.5
    with pytest.raises(DataError, match="noise"):
        map_of_grid(GridLog("run", Grid(free, ~free, 1.0, (0.0, 0.0, 0.0)), {}))
