"""Fleets: shares of a merge, processes and clusters that lose workers, caches that come and go."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial

import pytest

from topobatch.cli.matching import cluster
from topobatch.cli.stale import contents
from topobatch.cli.workspace import Workspace
from topobatch.merge.document import write_merged
from topobatch.merge.merging import merge_maps
from topobatch.merge.robust import Means
from topobatch.merge.workers import Workers

from ..viz.readback import Readback


@pytest.fixture(scope="session")
def fleet(once, fleet_maps):
    """A workspace with the maps of 18 runs in three buildings, and what merging them gives."""

    def make(root):
        fleet_maps(root / "maps", 18)
        place = Workspace(root)
        write(root / "expected", place, merge_maps([place.read_map(run) for run in place.runs()]))

    return once("fleet", make)


def write(path, place, result):
    """A merge as the command writes it, with the digests of its maps."""
    info = {**result.info, "maps": contents(place, place.runs())}
    write_merged(path, replace(result, info=info))


@pytest.fixture
def workspace(fleet, tmp_path):
    shutil.copytree(fleet / "maps", tmp_path / "ws" / "maps")
    return tmp_path / "ws"


def same(workspace, fleet) -> bool:
    """But for the names of sites, which hang on earlier merges."""
    merged = re.sub(rb'"site":"[^"]+",', b"", (workspace / "merged.json").read_bytes())
    return merged == (fleet / "expected").read_bytes()


@pytest.mark.parametrize("jobs", [1, 2])
def test_jobs(topobatch, workspace, fleet, jobs):
    for _ in range(2):
        done = topobatch("merge", "--all", "-j", jobs, "-w", workspace)
        assert done.code == 0, done
        assert same(workspace, fleet)
    assert "merged" in done.out


def test_a_run_that_comes_late(topobatch, workspace, fleet, tmp_path):
    """Beside what is kept its merge is that from scratch: document and recording."""
    late = sorted(workspace.glob("maps/*.json"))[7]
    late.rename(tmp_path / late.name)
    topobatch("merge", "--all", "-j", 1, "-w", workspace)
    assert not same(workspace, fleet)
    (tmp_path / late.name).rename(late)
    found = []
    for _ in range(2):
        done = topobatch("merge", "--all", "-j", 1, "-w", workspace)
        assert done.code == 0, done
        assert same(workspace, fleet)
        found.append(Readback(workspace / "merged.rrd").content())
        shutil.rmtree(workspace / "cache")
    assert found[0] == found[1]


def test_shares(topobatch, workspace, fleet):
    pairs = 0
    for k in (3, 1, 4, 2):
        done = topobatch("merge", "--all", "--shard", f"{k}/4", "-j", 1, "-w", workspace)
        assert done.code == 0, done
        pairs += int(done.out.split(": ")[1].split()[0])
    assert pairs == 18 * 17 // 2
    assert not (workspace / "merged.json").exists()
    topobatch("merge", "--all", "-j", 1, "-w", workspace)
    assert same(workspace, fleet)


@pytest.mark.parametrize("share", ["0/4", "5/4", "1", "a/b", "-1/2"])
def test_shares_that_are_none(topobatch, workspace, share):
    called = topobatch("merge", "--all", f"--shard={share}", "-w", workspace)
    assert "--shard is" in called.error(2)


CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        print(cluster.scheduler_address, *(w.pid for w in cluster.workers.values()), flush=True)
        sys.stdin.read()
"""


@pytest.fixture
def dask(tmp_path):
    """The address of a cluster of two processes, and their numbers."""
    pytest.importorskip("distributed")
    script = tmp_path / "cluster.py"
    script.write_text(CLUSTER)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, str(script)], text=True, **pipes) as process:
        address, *pids = process.stdout.readline().split()
        yield address, [int(pid) for pid in pids]
        process.stdin.close()


def test_a_cluster_by_the_command_and_one_that_loses_a_worker(dask, topobatch, workspace, fleet):
    address, pids = dask
    done = topobatch("merge", "--all", "--cluster", address, "-w", workspace)
    assert done.code == 0, done
    assert same(workspace, fleet)
    lost = []

    def lose_one(done, of):
        if done and not lost:
            os.kill(pids[0], signal.SIGKILL)
            lost.append((done, of))

    place = Workspace(workspace)
    maps = [place.read_map(run) for run in place.runs()]
    means = Means(Workers(partial(cluster, address)), read=place.read_map, on_pair=lose_one)
    write(workspace / "merged.json", place, merge_maps(maps, means=means))
    assert same(workspace, fleet)
    ((done, of),) = lost
    assert done < of


def dask_timeouts():
    import dask.config

    return dask.config.config["distributed"]["comm"]["timeouts"]


def test_a_cluster_that_is_none(topobatch, workspace, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setitem(dask_timeouts(), "connect", "1s")
    called = topobatch("merge", "--all", "--cluster", "tcp://127.0.0.1:1", "-w", workspace)
    assert called.code == 1
    assert "no scheduler answers" in called.err


@pytest.fixture
def large(monkeypatch):
    """Eighteen runs are a large merge."""
    monkeypatch.setattr("topobatch.merge.robust.screening.MOST_PAIRS", 100)
    monkeypatch.setattr("topobatch.merge.merging.MOST_PAIRS", 100)


def test_readers_cope_with_pairs_that_are_only_counted(topobatch, workspace, large):
    done = topobatch("merge", "--all", "-j", 1, "-w", workspace)
    assert done.code == 0, done
    document = json.loads((workspace / "merged.json").read_bytes())
    listed = {(entry["a"], entry["b"]) for entry in document["merges"]}
    unlisted = document["graph"]["unlisted"]
    assert sum(unlisted.values()) + len(listed) == 153
    assert f"{unlisted['screened'] + unlisted['unrelated']} unrelated" in done.out
    runs = sorted(run for c in document["graph"]["components"] for run in c["runs"])
    a, b = next((a, b) for a in runs for b in reversed(runs) if a < b and (a, b) not in listed)
    told = topobatch("explain", a, b, "-w", workspace)
    assert told.code == 0, told
    assert told.out.startswith(f"{a} and {b}: unrelated")
    assert "does not hold both" not in told.out + told.err
    told = topobatch("explain", a, b, "--json", "-w", workspace)
    assert json.loads(told.out)["of_merge"] is True
    assert json.loads(told.out)["threshold_bits"] == pytest.approx(
        17.29, abs=0.01
    )  # 153 count as 160
