"""`topobatch export`: which files it writes, and what it says."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from topobatch.cli.workspace import Workspace
from topobatch.topology.files import read_json, write_json


@pytest.fixture(scope="module")
def filled(merged_once, tmp_path_factory) -> Workspace:
    return Workspace(shutil.copytree(merged_once, tmp_path_factory.mktemp("export") / "ws"))


def run_of(place) -> str:
    return place.runs()[0]


def saved_map(folder: Path, name: str, cells: np.ndarray) -> Path:
    Image.fromarray(cells).save(folder / f"{name}.png")
    yaml = f"image: {name}.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
    (folder / f"{name}.yaml").write_text(yaml)
    return folder / f"{name}.yaml"


@pytest.mark.parametrize(
    ("form", "endings"),
    [
        ("nav2", [".geojson"]),
        ("lif", [".lif.json"]),
        ("rmf", [".rmf.yaml"]),
        ("tmap2", [".tmap2.yaml"]),
        ("graphml", [".graphml"]),
        ("g2o", [".g2o"]),
        ("tum", [".corrected.tum", ".recorded.tum"]),
        ("csv", [".corridors.csv", ".junctions.csv"]),
    ],
)
def test_a_run_goes_to_the_exports_of_its_workspace(topobatch, filled, form, endings) -> None:
    run = run_of(filled)
    shown = topobatch("export", run, "-f", form, "-w", filled.root)
    assert (shown.code, shown.err) == (0, "")
    paths = [filled.exports / f"{run}{ending}" for ending in endings]
    assert sorted(shown.out.split()) == [str(path) for path in paths]
    assert all(path.stat().st_size > 100 for path in paths)


def test_nodes_have_the_numbers_of_pictures(topobatch, buildings, tmp_path) -> None:
    document = read_json(Workspace(buildings).merged_json)
    last = document["graph"]["components"][-1]["id"]
    junctions = {
        n["id"]: [n["x"], n["y"]]
        for n in document["nodes"]
        if n["component"] == last and not n["kind"].startswith(("turn", "track", "front"))
    }
    assert min(junctions) > 0
    for form, suffix in (("nav2", "json"), ("rmf", "yaml")):
        out = tmp_path / f"{form}.{suffix}"
        call = ("export", "-f", form, "--component", last, "-o", out, "-w", buildings)
        assert topobatch(*call).code == 0
        if form == "rmf":
            names = re.findall(r"junction_(\d+)", out.read_text())
            assert set(map(int, names)) >= junctions.keys()
            continue
        features = json.loads(out.read_text())["features"]
        found = {
            f["properties"]["metadata"]["junction"]: f["geometry"]["coordinates"]
            for f in features
            if "junction" in f["properties"]["metadata"]
        }
        assert {k: found[k] for k in junctions} == junctions


def test_components_go_to_files_of_their_own(topobatch, filled, tmp_path) -> None:
    document = read_json(filled.merged_json)
    ids = [c["site"] for c in document["graph"]["components"]]
    out = tmp_path / "site.json"
    shown = topobatch("export", "merged", "-f", "nav2", "-o", out, "-w", filled.root)
    assert shown.code == 0
    expected = [tmp_path / f"site-{c}.json" for c in ids] if len(ids) > 1 else [out]
    assert shown.out.split() == [str(path) for path in expected]
    assert sorted(tmp_path.iterdir()) == expected
    one = topobatch(
        "export", "merged", "-f", "nav2", "-o", "-", "--site", ids[-1], "-w", filled.root
    )
    assert json.loads(one.out) == json.loads(expected[-1].read_text())
    assert one.err == ""


def test_the_calls_that_cannot_be(topobatch, filled, tmp_path) -> None:
    run, w = run_of(filled), ("-w", filled.root)
    for call, told in (
        (["nobody", "-f", "nav2"], "no run, site, merge or pair A:B named nobody"),
        ([run, "-f", "nav2", "--site", "0"], "goes with the merged map"),
        ([run, "-f", "nav2", "--component", "0"], "goes with the merged map"),
        (["merged", "-f", "nav2", "--component", "77"], "there is no component 77"),
        ([run, "-f", "csv", "-o", "-"], "do not go to the standard output"),
        ([run, "-f", "nav2", "--log", "x.mcap"], "goes with --format tum"),
    ):
        assert told in topobatch("export", *call, *w).error(2)
    told = topobatch("export", "merged", "-f", "nav2", "-w", tmp_path).error(1)
    assert "holds no maps yet" in told
    shutil.copytree(filled.maps, tmp_path / "maps")
    told = topobatch("export", "merged", "-f", "nav2", "-w", tmp_path).error(1)
    assert "topobatch merge --all" in told


@pytest.mark.skipif(sys.platform == "win32", reason="devices are files")
@pytest.mark.parametrize("place", ["/dev/full", "/dev/stdout", "fifo", "link"])
def test_devices_are_not_replaced_by_files(topobatch, filled, tmp_path, place) -> None:
    """Who may write there could put a file in their place."""
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "link").symlink_to("/dev/full")
    path, run = tmp_path / place, run_of(filled)
    (tmp_path / "places.csv").write_text("name,x,y\na,0,0\n")
    (tmp_path / "picture.svg").symlink_to("/dev/full")
    (tmp_path / "page.html").symlink_to("/dev/full")
    calls = (
        ("export", run, "-f", "nav2", "-o", path),
        ("export", run, "-f", "csv", "-o", path),
        ("transfer", tmp_path / "places.csv", "--from", run, "--to", "merged", "-o", path),
        ("draw", run, tmp_path / "picture.svg"),
        ("report", tmp_path / "page.html"),
    )
    before = os.lstat(path)
    for call in calls:
        error = topobatch(*call, "-w", filled.root).error(2)
        assert "is no file that could be written; name another" in error
    assert (os.lstat(path).st_mode, os.lstat(path).st_ino) == (before.st_mode, before.st_ino)


def test_a_log_that_is_gone_is_asked_for(topobatch, filled, logs, tmp_path) -> None:
    run = run_of(filled)
    record = filled.ingest_record(run)
    kept = record.read_text()
    try:
        write_json(record, json.loads(kept) | {"log": str(tmp_path / "gone.mcap")})
        told = topobatch("export", run, "-f", "tum", "-w", filled.root).error(1)
        assert "gone.mcap" in told
        assert "--log" in told
        record.unlink()
        assert "--log" in topobatch("export", run, "-f", "tum", "-w", filled.root).error(1)
        log = next(log for log in logs.values() if log.stem == run)
        fine = topobatch("export", run, "-f", "tum", "--log", log, "-w", filled.root)
        assert fine.code == 0
    finally:
        record.write_text(kept)


def test_a_log_that_the_map_was_not_made_from_is_refused(topobatch, filled, logs, tmp_path):
    run = logs["mcap"].stem
    call = ("export", run, "-f", "tum", "-o", tmp_path / "x.tum", "-w", filled.root)
    error = topobatch(*call, "--log", logs["other"]).error(1)
    assert f"{logs['other']}: is not the log that the map of run {run} was made from" in error
    assert not list(tmp_path.glob("x.*"))
    moved = shutil.copy(logs["mcap"], tmp_path / "moved.mcap")
    assert topobatch(*call, "--log", moved).code == 0
    record = filled.ingest_record(run)
    kept = record.read_text()
    try:
        shutil.copy(logs["other"], moved)
        write_json(record, json.loads(kept) | {"log": str(moved)})
        assert "changed since; ingest it again" in topobatch(*call).error(1)
    finally:
        record.write_text(kept)


def test_maps_of_grids_have_no_trajectories_and_cost_others_none(topobatch, filled, tmp_path):
    root, run = tmp_path / "ws", run_of(filled)
    shutil.copytree(filled.root, root)
    cells = np.zeros((200, 200), np.uint8)
    cells[40:60, 20:180] = cells[120:140, 20:180] = cells[20:180, 90:110] = 254
    assert topobatch("ingest", saved_map(tmp_path, "floor", cells), "-q", "-w", root).code == 0
    assert topobatch("merge", "floor", run, "--output", "two", "-q", "-w", root).code == 0
    shown = topobatch("export", "two", "-f", "tum", "-w", root)
    assert shown.code == 0, shown
    assert "floor: is the map of a grid, which nobody drove" in shown.err
    assert [Path(p).name.partition(".")[2] for p in shown.out.split()] == [
        f"{run}.recorded.tum",
        f"{run}.corrected.tum",
    ]
    assert "nobody drove" in topobatch("export", "floor", "-f", "tum", "-w", root).error(1)


def test_a_site_that_a_format_cannot_hold_costs_the_others_none(topobatch, filled, tmp_path):
    """A hall is one place without a corridor."""
    root, run = tmp_path / "ws", run_of(filled)
    shutil.copytree(filled.root, root)
    cells = np.pad(np.full((100, 150), 254, np.uint8), 5)
    assert topobatch("ingest", saved_map(tmp_path, "hall", cells), "-q", "-w", root).code == 0
    assert topobatch("merge", "hall", run, "--output", "two", "-q", "-w", root).code == 0
    shown = topobatch("export", "two", "-f", "nav2", "-w", root)
    assert shown.code == 0, shown
    assert "hall: has no corridor" in shown.err
    assert len(shown.out.split()) == 1
    assert "has no corridor" in topobatch("export", "hall", "-f", "nav2", "-w", root).error(1)


def test_maps_that_changed_since_the_merge_cost_the_times_only(topobatch, filled) -> None:
    document = read_json(filled.merged_json)
    component = document["graph"]["components"][0]
    run = sorted(component["runs"])[0]
    path = filled.map_json(run)
    kept = path.read_text()
    other = json.loads(kept)
    other["nodes"][0]["observations"][0]["time_ns"] += 1
    call = ("export", "merged", "-f", "nav2", "-o", "-", "--site", component["site"])
    with_times = topobatch(*call, "-w", filled.root)
    assert "abs_time_taken" in with_times.out
    try:
        path.write_text(json.dumps(other))
        shown = topobatch(*call, "-w", filled.root)
        assert shown.code == 0
        assert f"{run} has changed since" in shown.err
        assert "abs_time_taken" not in shown.out
        refused = topobatch(
            "export", "merged", "-f", "g2o", "--site", component["site"], "-w", filled.root
        )
        assert refused.code == 1
        path.unlink()
        assert f"{run}" in topobatch(*call, "-w", filled.root).err
    finally:
        path.write_text(kept)


def test_the_files_as_json(topobatch, filled) -> None:
    run = run_of(filled)
    done = topobatch("export", run, "-f", "csv", "--json", "-w", filled.root)
    endings = ("corridors.csv", "junctions.csv")
    files = [str(filled.exports / f"{run}.{ending}") for ending in endings]
    assert json.loads(done.out) == {"format": "csv", "files": files}
    error = topobatch("export", run, "-f", "nav2", "--json", "-o", "-", "-w", filled.root).error(2)
    assert "--output -" in error
