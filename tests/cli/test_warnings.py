"""No warning of Python or numpy reaches a terminal: not from any command, on logs sound and odd."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.cli import __main__ as entry
from topobatch.cli.main import COMMANDS
from topobatch.simulation import LaserSettings, ScenarioSettings, simulate_scenario, write_run


@pytest.fixture(scope="module")
def odd_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs that overlap, one of them also in centimetres, kilometres away, standing still, and
    with numbers that are none; and one of a laser."""
    folder = tmp_path_factory.mktemp("odd")
    settings = ScenarioSettings(runs=2, junctions_per_run=12, overlap=0.6, odometry_hz=5, seed=5)
    first, second = simulate_scenario(settings).simulated
    odd = {
        "centimetres": lambda pose: pose * [100, 100, 1],
        "far": lambda pose: np.add(pose, [3e5, -4e5, 0]),
        "still": lambda pose: pose * [0, 0, 1],
        "holes": lambda pose: np.where(np.arange(len(pose))[:, None] % 50 == 7, 1e300, pose),
        "tiny": lambda pose: pose * [1e-3, 1e-3, 1],
    }
    for simulated in (first, second):
        write_run(folder, simulated)
    for name, change in odd.items():
        odometry = replace(first.run.odometry, pose=change(first.run.odometry.pose))
        write_run(folder, replace(first, run=replace(first.run, name=name, odometry=odometry)))
    laser = LaserSettings(beams=60, rate_hz=3.0)
    office = ScenarioSettings(
        "office", runs=1, junctions_per_run=5, laser=laser, tells_junctions=False, prefix="laser"
    )
    write_run(folder, simulate_scenario(office).simulated[0])
    return folder


CALLS: dict[str, list[tuple[str, ...]]] = {
    "ingest": [("LOGS", "-j", "2")],
    "info": [("LOGS",)],
    "merge": [("--all", "-j", "2"), ("--all", "--method", "paper"), ("--all",)],
    "view": [("run1",)],
    "draw": [("merged", "OUT/merged.svg"), ("run1:run2", "OUT/pair.png")],
    "report": [("OUT/report.html",)],
    "list": [()],
    "explain": [("run1", "run2"), ("run1", "centimetres")],
    "export": [("merged", "-f", "nav2", "-o", "OUT/site.geojson"), ("run1", "-f", "tum")],
    "transfer": [("OUT/places.csv", "--from", "run1", "--to", "merged")],
    "changes": [()],
    "lock": [("run1", "far", "--never")],
    "discard": [("run1:far",)],
    "rename": [("run2", "second")],
    "history": [()],
    "schema": [("map",)],
    "simulate": [("OUT/simulated", "--runs", "2", "--junctions", "6", "--laser")],
}


@pytest.mark.slow
def test_no_warning_reaches_a_terminal(odd_logs: Path, tmp_path: Path) -> None:
    """Every command with warnings as errors, in its processes, too."""
    assert set(CALLS) == {name for name, _ in COMMANDS}
    (tmp_path / "places.csv").write_text("name,x,y\ndock,1.0,2.0\n")
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"TOPOBATCH_WORKSPACE": str(tmp_path / "ws"), "TOPOBATCH_DEBUG": "1"}
    for command, calls in CALLS.items():
        for call in calls:
            words = [
                word.replace("LOGS", str(odd_logs)).replace("OUT", str(tmp_path)) for word in call
            ]
            done = subprocess.run(
                [sys.executable, "-W", "error", "-m", "topobatch.cli", command, *words],
                capture_output=True, text=True, env=environment, check=False,
            )  # fmt: skip
            shown = done.stdout + done.stderr
            assert "Warning" not in shown, (command, words, shown)
            assert "Traceback" not in shown, (command, words, shown)
            refuses = {0, 1} if command in ("ingest", "info") else {0}  # the run that stands still
            assert done.returncode in refuses, (command, words, shown)


@pytest.mark.parametrize("shown", [False, True])
def test_what_libraries_warn_of_stays_off_the_terminal(
    monkeypatch: pytest.MonkeyPatch, shown: bool
) -> None:
    """Unless Python was told to show it."""
    monkeypatch.setattr(sys, "warnoptions", ["default"] if shown else [])
    monkeypatch.delenv("PYTHONWARNINGS", raising=False)

    def main() -> None:
        warnings.warn("divided by zero", RuntimeWarning, stacklevel=1)

    monkeypatch.setattr("topobatch.cli.main.main", main)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        entry.start()
    assert len(caught) == shown
    assert ("PYTHONWARNINGS" in os.environ) != shown
    monkeypatch.delenv("PYTHONWARNINGS", raising=False)
