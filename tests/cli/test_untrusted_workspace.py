"""What lies in a workspace may come from others: nothing there reaches out of it, or blocks."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest

from topobatch.cli.workspace import Workspace

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links and FIFOs")


@pytest.fixture
def victim(tmp_path):
    """Files outside of the workspace; whoever uses it finds them as they were."""
    folder = tmp_path / "victim"
    folder.mkdir()
    for name in ("x.json", "x.rrd", "precious", ".topobatch-abcdefgh.tmp"):
        (folder / name).write_text(name)
    yield folder
    found = {path.name: path.read_text() for path in folder.iterdir()}
    assert found == {name: name for name in found}
    assert len(found) == 4


def test_names_in_cache_records_remove_nothing(topobatch, reset_logs, victim, tmp_path):
    log = shutil.copy(reset_logs["parts"], tmp_path / "run.mcap")
    call = ("ingest", log, "-w", tmp_path / "ws")
    topobatch(*call)
    maps, cache = tmp_path / "ws" / "maps", tmp_path / "ws" / "cache" / "ingest"
    shutil.copy(maps / "run.json", maps / "other.json")
    record = json.loads((cache / "run.json").read_bytes())
    outside = ["../../victim/x", str(victim / "x"), "..", "", "a\0b", "other"]
    record["runs"] += outside
    (cache / "run.json").write_text(json.dumps(record))
    for name in ("other", "x"):
        (cache / f"{name}.json").write_text(json.dumps(record))
    (tmp_path / "victim" / "x.json").write_text("x.json")
    shutil.copy(reset_logs["whole"], log)
    assert topobatch(*call).code == 0
    assert sorted(p.name for p in maps.iterdir()) == ["other.json", "run.json", "run.rrd"]


@pytest.mark.parametrize("name", ["maps", "cache", "cache/ingest"])
def test_a_folder_that_is_a_link_is_refused(topobatch, logs, victim, tmp_path, name):
    link = tmp_path / "ws" / name
    link.parent.mkdir(parents=True)
    link.symlink_to(victim)
    assert f"{link}: is a link" in topobatch("ingest", logs["mcap"], "-w", tmp_path / "ws").error(1)


@pytest.mark.parametrize("kind", ["link", "FIFO", "folder"])
def test_a_lock_file_that_is_none_is_refused(topobatch, logs, victim, tmp_path, kind):
    place = tmp_path / "ws" / ".lock"
    put(place, kind, victim / "precious")
    assert f"{place}: is a {kind}" in topobatch("ingest", logs["mcap"], "-w", place.parent).error(1)


def put(place, kind, target):
    place.parent.mkdir(parents=True, exist_ok=True)
    place.unlink(missing_ok=True)
    {
        "link": lambda: place.symlink_to(target),
        "FIFO": lambda: os.mkfifo(place),
        "folder": lambda: (place / "more").mkdir(parents=True),
    }[kind]()


@pytest.mark.parametrize("kind", ["link", "FIFO", "folder"])
def test_what_is_no_document_is_not_opened(topobatch, logs, victim, tmp_path, kind):
    """What opens a FIFO waits: in a process of its own."""

    def call(*arguments):
        if kind != "FIFO":
            done = topobatch(*arguments, "-w", tmp_path)
            return done.code, done.err
        command = [sys.executable, "-m", "topobatch.cli", *map(str, arguments), "-w", str(tmp_path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        return done.returncode, done.stderr

    assert topobatch("ingest", logs["mcap"], "-w", tmp_path).code == 0
    (good,) = (tmp_path / "maps").glob("*.json")
    put(tmp_path / "maps" / "bad.json", kind, victim / "x.json")
    code, told = call("merge", "--all")
    assert code == 1
    assert f"bad.json: is a {kind}, not a document" in told.replace(", a device or a socket", "")
    put(tmp_path / "locks.json", kind, victim / "x.json")
    assert f"locks.json: is a {kind}" in call("merge", good.stem)[1]
    put(tmp_path / "cache" / "ingest" / good.name, kind, victim / "x.json")
    code, told = call("ingest", logs["mcap"])
    if kind == "folder":
        assert code == 1
        assert len(told.splitlines()) == 1
    else:  # a cache is made anew
        assert code == 0, told


@pytest.mark.parametrize("name", ["../x", "/x", "..", "", "a/b", ".hidden", "a\0b", "\ud800"])
def test_names_do_not_lead_out_of_the_workspace(topobatch, logs, tmp_path, name):
    place = Workspace(tmp_path)
    for path in (place.map_json, place.map_rrd, place.ingest_record):
        with pytest.raises(Exception, match="cannot name a run"):
            path(name)
    if "\0" not in name and name.isprintable():
        place.maps.mkdir()
        place.map_json("run").write_text("{}")
        assert topobatch("view", name, "-w", tmp_path).code == 2
