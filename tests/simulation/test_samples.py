"""The sample logs: one command makes them, the same messages everywhere, fit to show what we do."""

from __future__ import annotations

import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from topobatch.ingest.logs.recording import recording_at
from topobatch.ingest.reading import inspect_log, read_run
from topobatch.ingest.scans.stream import Mounting, ScanStream
from topobatch.simulation import Truth, read_truth
from topobatch.simulation.samples import sample_scenario

SAMPLES = Path(__file__).parents[2] / "sample_logs"
LOGS = ("maze-1.mcap", "maze-2.bag", "maze-3", "office-1.mcap", "streets-1.mcap")
WITH_DETECTIONS = tuple(log for log in LOGS if not log.startswith("office"))


def _files(folder: Path) -> dict[str, int]:
    """Size of every file that the command writes, by name."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "README.md")
    return {p.relative_to(folder).as_posix(): p.stat().st_size for p in files}


def _messages(log: Path) -> list[tuple[str, str, str, int, bytes]]:
    """Every message with its topic, type, hash of the type, and log time, as rosbags reads them."""
    with AnyReader([log]) as reader:
        return [(c.topic, c.msgtype, c.digest, t, bytes(raw)) for c, t, raw in reader.messages()]


@pytest.fixture(scope="module")
def truth() -> Truth:
    return read_truth(SAMPLES / "truth.json")


def test_one_command_writes_the_same_messages_anew(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "topobatch.simulation.samples", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    assert sorted(_files(tmp_path)) == sorted(_files(SAMPLES))
    assert (tmp_path / "truth.json").read_bytes() == (SAMPLES / "truth.json").read_bytes()
    for log in LOGS:
        made = _messages(tmp_path / log)
        assert len(made) > 1000
        assert made == _messages(SAMPLES / log), log


def test_they_are_small_and_come_in_three_containers() -> None:
    assert sum(_files(SAMPLES).values()) < 3_000_000
    assert (SAMPLES / "maze-1.mcap").read_bytes().startswith(b"\x89MCAP0\r\n")
    assert (SAMPLES / "maze-2.bag").read_bytes().startswith(b"#ROSBAG V2.0\n")
    assert (SAMPLES / "maze-3" / "maze-3.db3").read_bytes().startswith(b"SQLite format 3\0")
    assert "rosbag2_bagfile_information:" in (SAMPLES / "maze-3" / "metadata.yaml").read_text()


def test_three_runs_overlap_and_one_is_elsewhere(truth: Truth) -> None:
    groups = [{"maze-1", "maze-2", "maze-3"}, {"office-1"}, {"streets-1"}]
    assert truth.linked(least_common=12) == groups
    assert all(20 <= len(run.detected) <= 40 for run in truth.runs.values())
    for run in (truth.runs[Path(log).stem] for log in WITH_DETECTIONS):
        corridors = set(run.drive_edge.tolist())
        assert len(corridors) - len(run.detected) >= 2, "no loops to close"


def test_every_log_holds_the_run_that_was_simulated() -> None:
    simulated = sample_scenario().runs
    for log in WITH_DETECTIONS:
        run = read_run(SAMPLES / log)
        want = simulated[run.name]
        assert run.name == Path(log).stem
        assert run.warnings == ()
        assert run.odometry.time_ns.tolist() == want.odometry.time_ns.tolist()
        assert run.detections.time_ns.tolist() == want.detections.time_ns.tolist()
        assert run.detections.branches.counts.tolist() == want.detections.branches.counts.tolist()


def test_one_log_has_scans_and_no_detections(truth: Truth) -> None:
    raw = (SAMPLES / "office-1.mcap").read_bytes()
    assert len(raw) < 1_000_000
    topics = {topic.topic: topic for topic in inspect_log(SAMPLES / "office-1.mcap").topics}
    assert sorted(topics) == ["/odom", "/scan", "/tf_static"]
    assert topics["/scan"].use == "scans"
    scans = next(s.scans for s in sample_scenario().simulated if s.run.name == "office-1")
    assert scans is not None
    mounting = Mounting({"laser": np.array([0.15, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0])})
    stream = ScanStream(recording_at(SAMPLES / "office-1.mcap"), "/scan", mounting)
    ranges = np.concatenate([batch.ranges_m for batch in stream])
    want = np.where(np.isfinite(scans.ranges_m), scans.ranges_m, np.nan)
    np.testing.assert_array_equal(ranges, want)
    assert truth.runs["office-1"].doors


def test_the_figures_of_the_readme_are_those_of_the_logs(truth: Truth) -> None:
    lines = (SAMPLES / "README.md").read_text().splitlines()
    simulated = sample_scenario().runs
    for log in LOGS:
        run = simulated[Path(log).stem]
        way_m, seen = run.odometry.step_m.sum(), truth.runs[run.name].detected
        row = next(line for line in lines if line.startswith(f"| `{log}` |"))
        assert row.endswith(f"| {way_m:.0f} m | {len(seen)} |")
    text = " ".join(" ".join(lines).split())
    common = {
        (a, b): len(truth.runs[a].detected & truth.runs[b].detected)
        for a, b in combinations(("maze-1", "maze-2", "maze-3"), 2)
    }
    assert f"maze-1 and maze-2 have {common['maze-1', 'maze-2']} junctions in common" in text
    assert f"maze-2 and maze-3 have {common['maze-2', 'maze-3']}," in text
    assert f"maze-1 and maze-3 only {common['maze-1', 'maze-3']}" in text


def test_the_readme_names_every_log_and_its_command() -> None:
    text = (SAMPLES / "README.md").read_text()
    for log in LOGS:
        assert f"`{log}" in text
    assert "python -m topobatch.simulation.samples sample_logs" in text
