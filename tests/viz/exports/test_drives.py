"""Waypoints of drives, as tables and as features."""

from __future__ import annotations

import csv

import numpy as np

from topobatch.merge.drive import Drive, Stop
from topobatch.viz.exports.drives import drives_csv

STOPS = (Stop("a, b", 3, (0.0, 1.0)), Stop("c", 7, (2.0, 1.0)), Stop("a, b", None, (2.0, 4.0)))
DRIVE = Drive(
    0, "a, b", None, STOPS, np.array([(0.0, 1.0), (2.0, 1.0), (2.0, 4.0)]), 2.0, 5.0, (), 2.5, 1.5
)


def test_a_row_for_each_stop() -> None:
    rows = list(csv.reader(drives_csv([DRIVE, DRIVE]).splitlines()))
    assert rows[0] == ["drive", "stop", "frame", "site", "junction", "x", "y"]
    assert rows[1:4] == [
        ["1", "1", "a, b", "a, b", "3", "0.0", "1.0"],
        ["1", "2", "a, b", "c", "7", "2.0", "1.0"],
        ["1", "3", "a, b", "a, b", "", "2.0", "4.0"],
    ]
    assert [row[0] for row in rows[4:]] == ["2"] * 3
    assert drives_csv([]).count("\n") == 1
