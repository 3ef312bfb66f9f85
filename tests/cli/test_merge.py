"""`topobatch merge`: which runs, and what is said when something is wrong with them."""

from __future__ import annotations

import json
import shutil

import pytest


@pytest.fixture(scope="session")
def ready(logs, tmp_path_factory):
    """A workspace with two maps; copy it, do not change it."""
    from topobatch.ingest.mapping import build_map
    from topobatch.ingest.reading import read_run
    from topobatch.topology.document import write_map

    workspace = tmp_path_factory.mktemp("ready")
    for kind in ("mcap", "other"):
        topomap = build_map(read_run(logs[kind]))
        write_map(workspace / "maps" / f"{topomap.run}.json", topomap)
    return workspace


@pytest.fixture
def workspace(ready, tmp_path):
    return shutil.copytree(ready, tmp_path / "ws")


def test_which_runs(topobatch, workspace):
    a, b = sorted(p.stem for p in (workspace / "maps").glob("*.json"))
    assert "--all" in topobatch("merge", "-w", workspace).error(2)
    assert "not both" in topobatch("merge", a, "--all", "-w", workspace).error(2)
    error = topobatch("merge", a, "nobody", "-w", workspace).error(2)
    assert "nobody" in error
    assert b in error
    assert topobatch("merge", a, "-w", workspace).code == 0
    document = json.loads((workspace / "merged.json").read_bytes())
    assert [list(c["runs"]) for c in document["graph"]["components"]] == [[a]]


def test_the_order_of_names_does_not_matter(topobatch, workspace):
    a, b = sorted(p.stem for p in (workspace / "maps").glob("*.json"))
    topobatch("merge", a, b, "-w", workspace)
    first = (workspace / "merged.json").read_bytes()
    topobatch("merge", b, a, "-w", workspace)
    assert (workspace / "merged.json").read_bytes() == first
    topobatch("merge", "--all", "-w", workspace)
    assert (workspace / "merged.json").read_bytes() == first


def test_a_broken_map_does_not_stop_the_others(topobatch, workspace):
    (workspace / "maps" / "broken.json").write_text('{"schema": "topobatch.map/1"}')
    done = topobatch("merge", "--all", "-w", workspace)
    assert done.code == 1
    assert "broken.json" in done.err
    assert "1 pair: " in done.out
    assert (workspace / "merged.rrd").exists()


def test_only_broken_maps(topobatch, tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "x.json").write_text("{}")
    done = topobatch("merge", "--all", "-w", tmp_path)
    assert done.code == 1
    assert "none of the 1 map can be read" in done.err
