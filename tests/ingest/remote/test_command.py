"""`topobatch ingest` and `info` on a bucket: what is said, what is kept, what a bad log costs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SAMPLES = Path(__file__).parents[3] / "sample_logs"


def topobatch(*arguments: object) -> subprocess.CompletedProcess[str]:
    call = [sys.executable, "-m", "topobatch.cli", *map(str, arguments)]
    return subprocess.run(call, capture_output=True, text=True, check=False)


@pytest.fixture
def fleet(bucket: Any) -> Any:
    bucket.put("fleet/mon/maze-1.mcap", (SAMPLES / "maze-1.mcap").read_bytes())
    bucket.put("fleet/tue/maze-2.bag", (SAMPLES / "maze-2.bag").read_bytes())
    return bucket


def test_a_bucket_gives_the_same_documents_as_a_folder(fleet: Any, tmp_path: Path) -> None:
    done = topobatch("ingest", f"{fleet.url}/fleet/", "-w", tmp_path / "remote")
    assert (done.returncode, done.stderr) == (0, "")
    logs = (SAMPLES / "maze-1.mcap", SAMPLES / "maze-2.bag")
    assert topobatch("ingest", *logs, "-w", tmp_path / "local").returncode == 0
    for run in ("maze-1", "maze-2"):
        remote, local = (tmp_path / side / "maps" / f"{run}.json" for side in ("remote", "local"))
        assert remote.read_bytes() == local.read_bytes()
    record = json.loads((tmp_path / "remote" / "cache" / "ingest" / "maze-1.json").read_text())
    assert record["log"] == f"{fleet.url}/fleet/mon/maze-1.mcap"


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_did_not_change_is_not_read_again(fleet: Any, tmp_path: Path, jobs: int) -> None:
    call = ("ingest", f"{fleet.url}/fleet/", "-w", tmp_path, "-j", jobs)
    assert topobatch(*call).returncode == 0
    first = len(fleet.proxy.gets)
    fleet.proxy.clear()
    again = topobatch(*call)
    assert "(2 unchanged)" in again.stdout
    assert fleet.proxy.gets == []
    fleet.put("fleet/mon/maze-1.mcap", (SAMPLES / "maze-1.mcap").read_bytes())
    fleet.put("fleet/wed/streets-1.mcap", (SAMPLES / "streets-1.mcap").read_bytes())
    more = topobatch(*call)
    assert more.returncode == 0
    assert len(fleet.proxy.gets) < first


def test_a_log_without_index_costs_itself_alone(fleet: Any, tmp_path: Path) -> None:
    data = (SAMPLES / "streets-1.mcap").read_bytes()
    fleet.put("fleet/cut.mcap", data[:140_000])
    fleet.put("fleet/base.db3", next((SAMPLES / "maze-3").glob("*.db3")).read_bytes())
    call = ("ingest", f"{fleet.url}/fleet/", "-w", tmp_path)
    done = topobatch(*call)
    assert done.returncode == 1
    assert f"error: {fleet.url}/fleet/cut.mcap: it has no index" in done.stderr
    assert "--allow-scan does that" in done.stderr
    assert f"error: {fleet.url}/fleet/base.db3: a database can only be read" in done.stderr
    assert sorted(p.stem for p in (tmp_path / "maps").glob("*.json")) == ["maze-1", "maze-2"]
    allowed = topobatch(*call, "--allow-scan")
    assert (tmp_path / "maps" / "cut.json").is_file()
    assert "the log is cut short" in allowed.stderr


def test_a_run_from_a_bucket_is_listed_and_exported(fleet: Any, tmp_path: Path) -> None:
    log = f"{fleet.url}/fleet/mon/maze-1.mcap"
    assert topobatch("ingest", log, "-w", tmp_path).returncode == 0
    (row,) = json.loads(topobatch("list", "-w", tmp_path, "--json").stdout)
    assert row["stale"] == []
    exported = topobatch("export", "maze-1", "-f", "tum", "-w", tmp_path)
    assert exported.returncode == 0, exported.stderr


def test_wrong_addresses(tmp_path: Path) -> None:
    for address in ("s3://", "https://host", "https://host/logs/"):
        done = topobatch("ingest", address, "-w", tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith(f"error: {address}")
        assert done.stderr.count("\n") == 1
