"""Scans and grids by the command: simulated, shown, made into maps, and what is said of them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from topobatch.topology.files import read_json

SAMPLES = Path(__file__).parents[2] / "sample_logs"
OFFICE = SAMPLES / "office-1.mcap"


def test_simulated_lasers(topobatch, tmp_path):
    small = ("--runs", 1, "--junctions", 5, "--quiet")
    done = topobatch("simulate", tmp_path / "a", "--laser", *small, "--format", "bag")
    assert done.code == 0, done
    out = topobatch("info", tmp_path / "a" / "run1.bag").out
    assert "scans: default name" in out
    assert "/junctions" not in out
    truth = json.loads((tmp_path / "a" / "truth.json").read_text())
    assert truth["runs"]["run1"]["settings"]["laser"]["corridor_m"] == 1.4
    done = topobatch("simulate", tmp_path / "b", "--laser", "--detections", *small)
    assert done.code == 0, done
    out = topobatch("info", tmp_path / "b").out
    assert "junctions: default name" in out
    assert "shows the walls around places; --junctions-from scan finds" in out
    out = topobatch("info", tmp_path / "b", "--junctions-from", "scan").out
    assert "scans: default name" in out
    error = topobatch("simulate", tmp_path / "c", "--format", "rar").error(2)
    assert "choose one of mcap" in error
    assert not (tmp_path / "c").exists()


def test_a_log_with_scans_becomes_a_map_and_says_how(samples):
    said = (samples / "said.txt").read_text().splitlines()
    (line,) = (line for line in said if line.startswith("office-1: "))
    assert re.search(r" corridors, 11 ways without a junction at the end \([0-9.]+ s\)$", line)
    doc = read_json(samples / "topobatch-workspace" / "maps" / "office-1.json")
    ends = [node for node in doc["nodes"] if node["kind"] in ("turning_point", "track_end")]
    assert ends == doc["nodes"][-11:]
    assert doc["graph"]["driven"]["corridors"] > 0.95
    told = doc["graph"]["source"]["junctions"]
    assert (told["from"], told["topic"], told["scans"]) == ("scan", "/scan", told["messages"])


def test_ways_that_a_log_does_not_have(topobatch, tmp_path):
    error = topobatch("ingest", OFFICE, "--junctions-from", "topic", "-w", tmp_path).error(1)
    assert "no junction detections found" in error
    error = topobatch("ingest", OFFICE, "--junctions-from", "cloud", "-w", tmp_path).error(1)
    assert "PointCloud2" in error
    error = topobatch("ingest", OFFICE, "--scan-topic", "/odom", "-w", tmp_path).error(2)
    assert "--scan-topic needs sensor_msgs/LaserScan" in error
    assert "/laser" in topobatch("ingest", OFFICE, "--scan-topic", "laser", "-w", tmp_path).error(1)


@pytest.mark.parametrize("pose", ["1,2", "1,2,x", "1,2,3,4", "", "nan,0,0"])
def test_a_laser_pose_that_is_none(topobatch, tmp_path, pose):
    error = topobatch("ingest", OFFICE, "--laser-pose", pose, "-w", tmp_path).error(2)
    assert "--laser-pose" in error


def test_a_saved_map_is_a_map_like_any_other(topobatch, tmp_path):
    cells = np.full((300, 300), 0, np.uint8)
    for at in (60, 150, 260):
        cells[at : at + 25, 20:280] = cells[20:280, at : at + 25] = 254
    Image.fromarray(cells).save(tmp_path / "floor.png")
    (tmp_path / "floor.yaml").write_text(
        "image: floor.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
    )
    out = topobatch("info", tmp_path / "floor.yaml").out
    assert re.search(r"saved map, [0-9.]+ MB$", out, re.MULTILINE), "it has no times"
    (found,) = json.loads(topobatch("info", tmp_path / "floor.yaml", "--json").out)
    assert (found["start_ns"], found["duration_s"]) == (None, None)
    assert "grid: 300 x 300 cells of 0.05 m" in out
    done = topobatch("ingest", tmp_path / "floor.yaml", "-v", "-w", tmp_path / "ws")
    assert done.code == 0, done
    nodes = json.loads((tmp_path / "ws" / "maps" / "floor.json").read_text())["nodes"]
    assert sum(node["kind"] == "junction" for node in nodes) == 8, "one is a corner"
    assert "junctions from the grid floor.png" in done.err
    assert (tmp_path / "ws" / "maps" / "floor.rrd").is_file()
    (listed,) = json.loads(topobatch("list", "--json", "-w", tmp_path / "ws").out)
    assert listed["stale"] == []
    (tmp_path / "floor.png").unlink()
    error = topobatch("ingest", tmp_path / "floor.yaml", "-w", tmp_path / "ws").error(1)
    assert "floor.png is missing" in error
