"""The sample logs: one command makes them, the same messages everywhere, fit to show what we do."""

from __future__ import annotations

import subprocess
import sys
from itertools import combinations
from pathlib import Path

from rosbags.highlevel import AnyReader

from topobatch.simulation.samples import sample_scenario

SAMPLES = Path(__file__).parents[2] / "sample_logs"
LOGS = ("maze-1.mcap", "maze-2.bag", "maze-3", "office-1.mcap", "streets-1.mcap")


def _files(folder: Path) -> dict[str, int]:
    """Size of every file that the command writes, by name."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "README.md")
    return {p.relative_to(folder).as_posix(): p.stat().st_size for p in files}


def _messages(log: Path) -> list[tuple[str, str, str, int, bytes]]:
    """Every message with its topic, type, hash of the type, and log time, as rosbags reads them."""
    with AnyReader([log]) as reader:
        return [(c.topic, c.msgtype, c.digest, t, bytes(raw)) for c, t, raw in reader.messages()]


def test_one_command_writes_the_same_messages_anew(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "topobatch.simulation.samples", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    assert sorted(_files(tmp_path)) == sorted(_files(SAMPLES))
    assert (tmp_path / "truth.json").read_bytes() == (SAMPLES / "truth.json").read_bytes()
    for log in LOGS:
        made = _messages(tmp_path / log)
        assert len(made) > 1000
        assert made == _messages(SAMPLES / log), log


def test_the_figures_of_the_readme_are_those_of_the_logs() -> None:
    lines = (SAMPLES / "README.md").read_text().splitlines()
    scenario = sample_scenario()
    simulated, truth = scenario.runs, scenario.truth
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
