"""`topobatch changes`: what it says of runs between which corridors closed and opened."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from topobatch.cli.workspace import Workspace
from topobatch.merge.document import write_merged
from topobatch.merge.merging import merge_maps
from topobatch.simulation.settings import ScenarioSettings
from topobatch.topology.document import write_map

from .conftest import command, simulated_maps

MONTHS = ("--runs", 3, "--overlap", 0.8, "--junctions", 30, "--changes", 3, "--days", 60)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Workspace:
    folder = tmp_path_factory.mktemp("changes")
    command("simulate", folder / "months", *MONTHS)
    found = Workspace(folder / "ws")
    simulated_maps(found.root, ScenarioSettings("maze", 3, 0.8, 30, changes=3, days=60))
    write_merged(found.merged_json, merge_maps([found.read_map(run) for run in found.runs()]))
    return found


def test_changes_are_told_with_dates(topobatch, place) -> None:
    shown = topobatch("changes", "-w", place.root)
    assert (shown.code, shown.err) == (0, "")
    told = json.loads(topobatch("changes", "-w", place.root, "--json").out)
    true = json.loads((place.root.parent / "months" / "truth.json").read_text())["changes"]
    assert sorted(c["kind"] for c in told) == sorted("new" if c["open"] else "gone" for c in true)
    for change in told:
        assert "first missing 2024-" in shown.out or change["kind"] == "new"
    for words in ("gone: corridor of", "driven by run1", "missing for run3", "last found 2024-"):
        assert words in shown.out
    *_, count, hint = shown.out.splitlines()
    assert f"{len(told)} changes" in count
    assert f"topobatch changes -o changes.svg -w {place.root}" in hint
    every = json.loads(topobatch("changes", "-w", place.root, "--json", "--all").out)
    assert len(every) >= len(told)


def test_changes_are_drawn_with_the_numbers_of_their_list(topobatch, place, tmp_path) -> None:
    both = ("-o", tmp_path / "changes.svg", "-o", tmp_path / "changes.png")
    shown = topobatch("changes", *both, "-w", place.root)
    assert (shown.code, shown.err) == (0, "")
    assert (tmp_path / "changes.png").read_bytes()[1:4] == b"PNG"
    svg = (tmp_path / "changes.svg").read_text()
    assert "What changed: " in svg
    assert "1. " in svg
    assert "<title>Gone: corridor of" in svg
    assert "gone, with its number in the list" in svg
    assert "1. " in shown.out
    assert "gone: corridor of" in " ".join(re.findall(r">([^<>]*)</text>", svg))
    dark = tmp_path / "dark.svg"
    assert topobatch("changes", "-o", dark, "--theme", "dark", "-w", place.root).code == 0
    assert "#0f1115" in dark.read_text()
    assert "ends in .svg or .png" in topobatch("changes", "-o", "a.txt", "-w", place.root).error(2)


@pytest.mark.parametrize("form", ["nav2", "lif", "rmf", "tmap2", "graphml", "csv"])
def test_exports_mark_the_corridors_that_are_gone(topobatch, place, tmp_path, form) -> None:
    told = json.loads(topobatch("changes", "-w", place.root, "--json").out)
    gone = [c for c in told if c["kind"] == "gone"]
    out = tmp_path / "site"
    shown = topobatch("export", "-f", form, "-o", out, "-w", place.root)
    assert shown.code == 0
    assert f"{len(gone)} corridors are gone" in shown.err
    assert "topobatch changes " in shown.err
    text = "".join(path.read_text() for path in tmp_path.glob("site*"))
    if form == "nav2":
        edges = [f["properties"].get("metadata", {}) for f in json.loads(text)["features"]]
        marked = [m for m in edges if m.get("gone")]
        assert len({m["corridor"] for m in marked}) == len(gone)
        assert {m["last_run"] for m in marked} == {c["there"][-1]["run"] for c in gone}
        assert all(m["last_found"].startswith("2024-") for m in marked)
    else:
        assert ("last_found" if form == "csv" else "gone") in text


def test_calls_that_cannot_be(topobatch, place, tmp_path) -> None:
    assert "topobatch ingest" in topobatch("changes", "-w", tmp_path).error(1)
    assert "no component 9" in topobatch("changes", "--component", 9, "-w", place.root).error(2)
    alone = Workspace(tmp_path / "alone")
    one = place.read_map("run1")
    write_map(alone.map_json("run1"), one)
    write_merged(alone.merged_json, merge_maps([one]))
    shutil.copytree(place.root, tmp_path / "same")
    same = Workspace(tmp_path / "same")
    twin = replace(one, run="twin")
    write_map(same.map_json("twin"), twin)
    write_merged(same.merged_json, merge_maps([one, twin]))
    assert ": nothing changed\n" in topobatch("changes", "-w", same.root).out
    assert "nothing to compare" in topobatch("changes", "-w", alone.root).out
    # A saved map has neither times nor passes: what it lacks was not missed by anybody.
    none = np.zeros(0, np.int64)
    saved = replace(
        place.read_map("run3"), observation_vertex=none, observation_time_ns=none, traversal_ns=None
    )
    write_map(same.map_json("twin"), replace(saved, run="twin"))
    write_merged(same.merged_json, merge_maps([one, replace(saved, run="twin")]))
    shown = topobatch("changes", "--all", "-w", same.root).out
    assert "no two recorded runs" in shown
    assert "saved maps tell no times and are left out: twin" in shown
    write_map(alone.map_json("run1"), replace(one, observation_time_ns=one.observation_time_ns + 1))
    other = place.read_map("run2")
    write_map(alone.map_json("run2"), other)
    write_merged(alone.merged_json, merge_maps([one, other]))
    assert "merge again" in topobatch("changes", "-w", alone.root).error(1)
