"""`topobatch explain` of runs that no merge holds: what their two maps say by themselves."""

from __future__ import annotations

import json
import shutil

import pytest

from topobatch.simulation.settings import ScenarioSettings

from .conftest import simulated_maps


@pytest.fixture(scope="session")
def sites(once):
    """A workspace with the maps of four runs in a maze and two among rows, not merged."""
    maze = ScenarioSettings("maze", 4, 0.25, 30, prefix="maze", seed=3)
    rows = ScenarioSettings("rows", 2, 0.5, 30, prefix="rows", seed=5)
    return once("explained", lambda folder: simulated_maps(folder, maze, rows))


@pytest.fixture
def workspace(sites, tmp_path):
    return shutil.copytree(sites, tmp_path / "ws")


def explained(topobatch, workspace, pair):
    return json.loads(topobatch("explain", *pair, "--json", "-w", workspace).out)


def test_runs_are_explained_by_themselves_before_a_merge(topobatch, workspace):
    alone = "this is what the two maps say by themselves, asked as one pair of 6 maps"
    before = explained(topobatch, workspace, ("maze1", "maze2"))
    assert before["of_merge"] is False
    (note,) = before["notes"]
    assert note.startswith(f"not merged yet (topobatch merge --all); {alone}; ")
    assert topobatch("merge", "--all", "-w", workspace).code == 0
    after = explained(topobatch, workspace, ("maze1", "maze2"))
    assert after["of_merge"] is True
    assert after["notes"] == []
    assert after["threshold_bits"] == before["threshold_bits"]
    assert [p["transform"] for p in after["placements"]] == [
        p["transform"] for p in before["placements"]
    ]
    # A run that came after a merge is asked with the settings of that merge.
    few = ("merge", "maze1", "maze2", "--replace", "--false-merge-rate", "0.05")
    assert topobatch(*few, "-w", workspace).code == 0
    told = explained(topobatch, workspace, ("maze3", "maze4"))
    assert told["requirement"]["false_merge_rate"] == 0.05
    (note,) = told["notes"]
    assert f"merged.json does not hold both runs; {alone}" in note
    few = ("merge", "maze1", "maze2", "--output", "p", "--method", "paper")
    assert topobatch(*few, "--false-merge-rate", "0.01", "-w", workspace).code == 0
    told = topobatch("explain", "maze1", "maze2", "--merge", "p", "-w", workspace).out
    assert "/ rate 0.01)" in told
    assert "asked as one pair of 6 maps" in " ".join(told.split())
