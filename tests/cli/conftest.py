"""The command, called in this process, and small logs to call it on."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from topobatch.cli.main import main
from topobatch.ingest.simulation import ScenarioSettings, simulate_scenario
from topobatch.ingest.simulation.writing import write_run


@dataclass(frozen=True)
class Shown:
    """What a call left: exit code, standard output, standard error."""

    code: int
    out: str
    err: str

    def error(self, code: int) -> str:
        """The only line of the standard error, which must be an error."""
        assert self.code == code, self
        (line,) = self.err.strip().splitlines()
        assert line.startswith("error: "), line
        return line


@pytest.fixture
def topobatch(monkeypatch, capfd) -> Callable[..., Shown]:
    monkeypatch.delenv("TOPOBATCH_WORKSPACE", raising=False)
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)

    def call(*arguments: object) -> Shown:
        monkeypatch.setattr(sys, "argv", ["topobatch", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capfd.readouterr()
        return Shown(int(ended.value.code or 0), out, err)

    return call


@pytest.fixture(scope="session")
def logs(tmp_path_factory) -> dict[str, Path]:
    """One small run in four containers, and another run that overlaps with it."""
    settings = ScenarioSettings(
        runs=2, junctions_per_run=10, overlap=0.6, drift="low", odometry_hz=10, seed=5
    )
    simulated = simulate_scenario(settings).simulated
    folder = tmp_path_factory.mktemp("logs")
    out = {
        kind: write_run(folder / kind, simulated[0], kind)
        for kind in ("mcap", "bag", "db3", "ros2-mcap")
    }
    out["other"] = write_run(folder / "other", simulated[1])
    return out
