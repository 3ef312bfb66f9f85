"""`topobatch lock`: what the maps say against it is shown before it is kept, and goes on."""

from __future__ import annotations

import json
import shutil

import pytest

from topobatch.merge.robust.entries import MAPS_ALONE
from topobatch.merge.robust.verdict import MAYBE_COPY
from topobatch.simulation.settings import ScenarioSettings

from .conftest import simulated_maps


@pytest.fixture(scope="session")
def sites(once):
    """Two runs in a maze, which merge, and two among equal rows, which may be copies."""
    maze = ScenarioSettings("maze", 2, 0.6, 30, prefix="maze", seed=5)
    rows = ScenarioSettings("rows", 2, 0.5, 30, prefix="rows", seed=5)
    return once("locked", lambda folder: simulated_maps(folder, maze, rows))


@pytest.fixture
def workspace(sites, tmp_path):
    return shutil.copytree(sites, tmp_path / "ws")


def locks(workspace):
    path = workspace / "locks.json"
    return json.loads(path.read_text())["locks"] if path.exists() else []


def test_what_the_maps_say_as_well_is_no_warning(topobatch, workspace):
    for call in (
        ("lock", "maze1", "maze2", "--same"),
        ("lock", "maze1", "maze2", "--clear"),
        ("lock", "rows1", "rows2", "--never"),
        ("lock", "maze1", "maze2", "--same"),
        ("merge", "--all", "-j", 1),
    ):
        done = topobatch(*call, "-w", workspace)
        assert (done.code, done.err) == (0, "")


def test_what_may_be_a_copy_is_said_by_the_merge(topobatch, workspace):
    assert topobatch("merge", "--all", "-j", 1, "-w", workspace).code == 0
    done = topobatch("lock", "rows2", "rows1", "--same", "-w", workspace)
    assert (done.code, done.err) == (0, "")
    listed = topobatch("list", "-w", workspace).out
    assert listed.count("lock changed: merge again") == 2
    told = topobatch("merge", "--all", "-j", 1, "-w", workspace)
    assert f"warning: rows1 and rows2 are joined by a lock; by their maps {MAYBE_COPY}" in told.err
    assert "weakest link rows1 + rows2, joined by a lock" in " ".join(told.out.split())
    assert "lock changed" not in topobatch("list", "-w", workspace).out
    entries = json.loads((workspace / "merged.json").read_bytes())["merges"]
    (entry,) = (e for e in entries if (e["a"], e["b"]) == ("rows1", "rows2"))
    assert entry["accepted_by"] == "lock"
    assert entry["reason"].endswith(f"{MAPS_ALONE} ambiguous, {MAYBE_COPY}")
