"""Noise is told from large buildings by how long its ways are, not by how many there are."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.skeleton_lines import FEW_LINES, MOST_LINES, lines_of
from topobatch.topology.errors import DataError


def lattice(ways: int, cells: int) -> np.ndarray:
    """A skeleton of some `ways` lines of `cells` cells each: forks take three more."""
    step = cells + 3
    side = step * int(np.sqrt(ways / 2)) + 1
    skeleton = np.zeros((side, side), bool)
    skeleton[::step] = True
    skeleton[:, ::step] = True
    return skeleton


@pytest.mark.parametrize(
    ("ways", "cells", "said"),
    [
        (FEW_LINES + 2000, 8, ""),
        (FEW_LINES + 2000, 3, "this is noise, and no building"),
        (FEW_LINES - 2000, 3, ""),
        (MOST_LINES + 2000, 8, "cut the grid into parts"),
    ],
)
def test_noise_is_told_from_a_large_building(ways, cells, said):
    skeleton = lattice(ways, cells)
    clearance, border = np.ones(skeleton.shape, np.float32), np.zeros(skeleton.shape, bool)
    if said:
        with pytest.raises(DataError, match=said):
            lines_of(skeleton, clearance, 0.1, border)
        return
    lines = lines_of(skeleton, clearance, 0.1, border)
    assert abs(len(lines.length_m) - 1 - ways) < 0.05 * ways
    # Between crossings, and into both.
    assert np.median(lines.length_m[1:]) == pytest.approx(0.1 * (cells + 1))


def test_a_skeleton_that_fills_the_grid_is_noise():
    cells = np.ones((1024, 1100), bool)
    with pytest.raises(DataError, match=r"1,126,400 cells .* this is noise"):
        lines_of(cells, cells.astype(np.float32), 0.1, ~cells)
