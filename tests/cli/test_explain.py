"""`topobatch explain` of runs that no merge holds: what a merge would say."""

from __future__ import annotations

import json
import shutil

import pytest

from topobatch.simulation import ScenarioSettings

from .conftest import simulated_maps

SAID = (
    "verdict",
    "accepted",
    "accepted_by",
    "locked",
    "through",
    "evidence_bits",
    "threshold_bits",
)
"""Entries that a merge and `explain` both state."""


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


def check_as_merged(topobatch, workspace, pairs, *options):
    """That these pairs are explained as a merge of all runs then decides on them."""
    before = {pair: explained(topobatch, workspace, pair) for pair in pairs}
    assert topobatch("merge", "--all", *options, "-w", workspace).code == 0
    merges = json.loads((workspace / "merged.json").read_bytes())["merges"]
    entries = {(entry["a"], entry["b"]): entry for entry in merges}
    for pair, told in before.items():
        said = {"through": [], "accepted_by": None, "locked": None} | entries[pair]
        assert {k: told[k] for k in SAID} == {k: said[k] for k in SAID}, pair
        assert told["of_merge"] is False
        assert "this is what a merge of 6 maps would say" in told["notes"][0]
        after = explained(topobatch, workspace, pair)
        assert after["of_merge"] is True
        assert after["notes"] == []
        assert after["placements"] == told["placements"]
    return entries


def test_runs_are_explained_as_a_merge_would_decide(topobatch, workspace):
    """A merge also weighs how buildings like theirs repeat themselves, and who joins whom."""
    pairs = [("maze1", "maze2"), ("maze2", "maze3"), ("maze3", "maze4"), ("maze1", "rows1")]
    entries = check_as_merged(topobatch, workspace, pairs)
    assert entries["maze1", "maze2"]["accepted"]
    assert entries["maze2", "maze3"]["through"]
    # A run that came after a merge is asked with the settings of that merge.
    few = ("merge", "maze1", "maze2", "--replace", "--false-merge-rate", "0.05")
    assert topobatch(*few, "-w", workspace).code == 0
    told = explained(topobatch, workspace, ("maze3", "maze4"))
    assert told["requirement"]["false_merge_rate"] == 0.05
    assert told["notes"] == [
        "merged.json does not hold both runs; this is what a merge of 6 maps would say, with the "
        "settings of merged.json"
    ]
    few = ("merge", "maze1", "maze2", "--output", "p", "--method", "paper")
    assert topobatch(*few, "--false-merge-rate", "0.01", "-w", workspace).code == 0
    told = topobatch("explain", "maze1", "maze2", "--merge", "p", "-w", workspace).out
    assert "log2(1 pair / rate 0.01)" in told
    told = " ".join(told.split())
    assert "this is what a merge of 2 maps would say, at the rate of p.json" in told


def test_what_a_person_said_of_runs_counts_before_a_merge(topobatch, workspace):
    topobatch("lock", "maze1", "maze2", "--never", "-w", workspace)
    topobatch("lock", "rows1", "rows2", "--same", "-w", workspace)
    topobatch("discard", "maze3:maze4", "-w", workspace)
    pairs = [("maze1", "maze2"), ("rows1", "rows2"), ("maze3", "maze4"), ("maze1", "maze3")]
    entries = check_as_merged(topobatch, workspace, pairs)
    assert entries["maze1", "maze2"]["locked"] == "never"
    assert entries["rows1", "rows2"]["accepted_by"] == "lock"
    assert "discarded" in entries["maze3", "maze4"]["reason"]
