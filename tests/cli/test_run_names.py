"""Names of runs: what tells logs of one name apart, and that names stay."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from topobatch.cli.run_names import run_names
from topobatch.cli.workspace import Workspace
from topobatch.ingest.reading import log_fingerprint


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


def record(place: Workspace, run: str, log: Path | str, content: str = "") -> None:
    path = place.ingest_record(run)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"log": str(log), "runs": [run], "content": content}))


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


def test_names_may_lose_what_tells_paths_apart():
    first, second = run_names([Path("/a:b.mcap"), Path("/a-b.mcap")]).values()
    assert {first, second} == {"a-b", "a-b.mcap"}


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


def test_a_log_without_collision_now_is_named_like_those_of_its_fleet(tmp_path):
    place = Workspace(tmp_path / "ws")
    for robot in ("r1", "r2"):
        named(tmp_path, f"{robot}/a.mcap")
        record(place, f"{robot}-a", tmp_path / robot / "a.mcap")
    assert named(tmp_path, "r3/a.mcap", place=place) == {"r3/a.mcap": "r3-a"}
    assert named(tmp_path, "r2/a.mcap", place=place) == {"r2/a.mcap": "r2-a"}


def test_a_name_that_was_given_by_hand_is_taken(tmp_path):
    place = Workspace(tmp_path / "ws")
    named(tmp_path, "x/other.mcap")
    record(place, "a", tmp_path / "x" / "other.mcap")
    assert named(tmp_path, "r1/a.mcap", place=place) == {"r1/a.mcap": "r1-a"}


def test_a_moved_log_keeps_its_name_and_another_in_its_place_does_not(tmp_path):
    place = Workspace(tmp_path / "ws")
    log = tmp_path / "new" / "a.mcap"
    log.parent.mkdir()
    log.write_bytes(b"\x89MCAP0\r\n" + b"first")
    record(place, "a", tmp_path / "old" / "a.mcap", log_fingerprint(log))
    assert run_names([log], place) == {log: "a"}
    log.write_bytes(b"\x89MCAP0\r\n" + b"second")
    assert run_names([log], place) == {log: "new-a"}
    # While the first is there, its copy is another log.
    record(place, "a", named_log := tmp_path / "a.mcap", log_fingerprint(log))
    named_log.write_bytes(log.read_bytes())
    assert run_names([log], place) == {log: "new-a"}


def test_a_renamed_run_is_found(tmp_path):
    place = Workspace(tmp_path / "ws")
    named(tmp_path, "r1/a.mcap")
    record(place, "monday", tmp_path / "r1" / "a.mcap")
    place.ingest_record("a").write_text(json.dumps({"renamed": "monday"}))
    place.maps.mkdir()
    place.map_json("monday").touch()
    # `ingest` goes on to the new name.
    assert named(tmp_path, "r1/a.mcap", "r2/a.mcap", place=place) == {
        "r1/a.mcap": "a",
        "r2/a.mcap": "r2-a",
    }


@pytest.mark.parametrize("log", [7, "", "\0", "s3://", "x" * 5000, None])
def test_records_that_nobody_wrote_do_no_harm(tmp_path, log):
    place = Workspace(tmp_path / "ws")
    path = place.ingest_record("a")
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"log": log}))
    (name,) = named(tmp_path, "r1/a.mcap", place=place).values()
    assert name in ("a", "r1-a")
