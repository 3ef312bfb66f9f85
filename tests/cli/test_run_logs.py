"""Names of runs: what tells logs of one name apart, and that names stay."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from topobatch.cli.run_logs import run_names
from topobatch.cli.workspace import Workspace


def named(root: Path, *paths: str, place: Workspace | None = None, force: bool = False):
    """The names of logs below a folder by their paths there, of which folders end with /."""
    for path in paths:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        if path.endswith("/"):
            (root / path).mkdir(exist_ok=True)
        else:
            (root / path).touch()
    logs = [root / path for path in paths]
    random.Random(len(paths)).shuffle(logs)
    names = run_names(logs, place, replace=force)
    return {path: names[root / path] for path in paths}


def record(place: Workspace, run: str, log: Path) -> None:
    path = place.ingest_record(run)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"log": str(log), "runs": [run]}))


@pytest.mark.parametrize(
    "names",
    [
        {"a.mcap": "a", "b/c.bag": "c"},
        {"robot1/run01.mcap": "robot1-run01", "robot2/run01.mcap": "robot2-run01", "x.bag": "x"},
        {"f1/map.yaml": "f1-map", "f2/map.yaml": "f2-map", "f2/map2.yaml": "map2"},
        {"a.bag": "a.bag", "a/": "a"},
        {"a.bag": "a.bag", "a.mcap": "a.mcap", "a.bag.active": "a.bag.active"},
        {"r1/a.bag": "r1-a.bag", "r1/a.mcap": "r1-a.mcap", "r2/a.bag": "r2-a"},
        {"r1/a.bag": "r1-a", "r2/a.mcap": "r2-a"},
        {"r1/mon/a.bag": "r1-mon-a", "r2/mon/a.bag": "r2-mon-a", "r2/tue/a.bag": "tue-a"},
        # A longer name is taken by a log that is called so.
        {"s/r1/a.bag": "s-r1-a", "r2/a.bag": "r2-a", "r1-a.bag": "r1-a"},
        {"r:1/a.bag": "r-1-a", "r2/a.bag": "r2-a"},
    ],
)
def test_names_are_the_shortest_paths_that_tell_logs_apart(tmp_path, names):
    assert named(tmp_path, *names) == names


def test_a_run_of_the_workspace_keeps_its_name(tmp_path):
    place = Workspace(tmp_path / "ws")
    assert named(tmp_path, "r1/a.mcap", place=place) == {"r1/a.mcap": "a"}
    record(place, "a", tmp_path / "r1" / "a.mcap")
    # A week later.
    both = {"r1/a.mcap": "a", "r2/a.mcap": "r2-a"}
    assert named(tmp_path, *both, place=place) == both
    assert named(tmp_path, "r2/a.mcap", place=place) == {"r2/a.mcap": "r2-a"}
    record(place, "r2-a", tmp_path / "r2" / "a.mcap")
    every = {**both, "r3/a.mcap": "r3-a", "b.mcap": "b"}
    assert named(tmp_path, *every, place=place) == every
    # Maps of others are replaced where that is asked for.
    assert named(tmp_path, "r3/a.mcap", place=place, force=True) == {"r3/a.mcap": "a"}
