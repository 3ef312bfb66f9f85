"""Waypoints of drives, as tables and as features."""

from __future__ import annotations

import csv
import json

import numpy as np

from topobatch.merge.drive import Drive, Stop
from topobatch.viz.exports.drives import drives_csv, drives_geojson

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


def test_a_line_for_each_drive_and_a_point_for_each_stop() -> None:
    features = json.loads(drives_geojson([DRIVE]))["features"]
    assert [f["geometry"]["type"] for f in features] == ["LineString", "Point", "Point", "Point"]
    assert features[0]["geometry"]["coordinates"] == DRIVE.path.tolist()
    assert features[0]["properties"]["bits_per_metre"] == 0.5
    assert features[2]["properties"] == {
        "drive": 1, "frame": "a, b", "stop": 2, "site": "c", "junction": 7,
    }  # fmt: skip
