"""The command, called in this process, and small logs to call it on."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from topobatch.cli.main import main
from topobatch.ingest.mapping import build_map
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.writing import write_run
from topobatch.topology.document import write_map
from topobatch.topology.se2 import compose, inverse

from ..conftest import command


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


def simulated_maps(folder: Path, *scenarios: ScenarioSettings) -> None:
    """Write the maps of simulated runs into a workspace."""
    for settings in scenarios:
        for name, run in simulate_scenario(settings).runs.items():
            write_map(folder / "maps" / f"{name}.json", build_map(run))


def nameless(workspace: Path) -> dict[str, Any]:
    """The merge without the names of its sites, which hang on earlier merges."""
    found = json.loads((workspace / "merged.json").read_bytes())
    for component in found["graph"]["components"]:
        assert component.pop("site")
    return found


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
def logs(once) -> dict[str, Path]:
    """One small run in four containers, and another run that overlaps with it."""
    settings = ScenarioSettings(
        runs=2, junctions_per_run=10, overlap=0.6, drift="low", odometry_hz=10, seed=5
    )
    kinds = ("mcap", "bag", "db3", "ros2-mcap")

    def write(folder: Path) -> None:
        simulated = simulate_scenario(settings).simulated
        for kind in kinds:
            write_run(folder / kind, simulated[0], kind)
        write_run(folder / "other", simulated[1])

    folder = once("logs", write)
    return {kind: next((folder / kind).iterdir()) for kind in (*kinds, "other")}


@pytest.fixture(scope="session")
def ingested(logs, once) -> Path:
    """A workspace of run1 and run2, which overlap, not merged yet."""
    both = logs["mcap"], logs["other"]
    return once("ingested", lambda folder: command("ingest", *both, "-j", 1, "-q", "-w", folder))


def _merged(maps: Path, folder: Path) -> None:
    shutil.copytree(maps, folder, dirs_exist_ok=True)
    command("merge", "--all", "-j", 1, "-q", "-w", folder)


@pytest.fixture(scope="session")
def merged_once(ingested, once) -> Path:
    return once("merged", partial(_merged, ingested))


@pytest.fixture
def workspace(ingested, tmp_path) -> Path:
    """A copy of the ingested workspace."""
    return shutil.copytree(ingested, tmp_path / "ws")


@pytest.fixture
def merged(merged_once, tmp_path) -> Path:
    """A copy of it, merged."""
    return shutil.copytree(merged_once, tmp_path / "ws")


@pytest.fixture(scope="session")
def two_buildings(fleet_maps, once) -> Path:
    """A workspace with the maps of five runs of one building and of two of another."""
    return once("two-buildings", lambda folder: fleet_maps(folder / "maps", 12, keep=7))


@pytest.fixture(scope="session")
def buildings_once(two_buildings, once) -> Path:
    return once("buildings", partial(_merged, two_buildings))


@pytest.fixture
def buildings(buildings_once, tmp_path) -> Path:
    """A copy of it, merged."""
    return shutil.copytree(buildings_once, tmp_path / "ws")


@pytest.fixture(scope="session")
def reset_logs(once) -> dict[str, Path]:
    """Logs of three runs whose odometry was reset half way: of "joins" and "parts" the halves share
    places, or too few; "whole" is the second without the reset."""
    folder = once("reset-logs", _write_reset_logs)
    return {path.name: next(path.iterdir()) for path in folder.iterdir()}


def _write_reset_logs(folder: Path) -> None:
    for name, seed, reset in (("joins", 1, True), ("parts", 3, True), ("whole", 3, False)):
        settings = ScenarioSettings(
            runs=1, junctions_per_run=14, drift="low", odometry_hz=10, seed=seed
        )
        simulated = simulate_scenario(settings).simulated[0]
        if reset:
            odometry = simulated.run.odometry
            pose, half = odometry.pose.copy(), len(odometry) // 2
            pose[half:] = compose(inverse(pose[half]), pose[half:])
            run = replace(simulated.run, odometry=replace(odometry, pose=pose))
            simulated = replace(simulated, run=run)
        write_run(folder / name, simulated)


@pytest.fixture(scope="session")
def fleet_maps():
    """fleet_maps(folder, runs): write the maps of runs in buildings of six; keep: only so many."""
    path = Path(__file__).parents[2] / "benchmarks" / "fleet.py"
    spec = importlib.util.spec_from_file_location("topobatch_fleet", path)
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))

    def write(folder, runs, keep=None):
        for topomap, _ in module.fleet_of(runs, per_site=6, world=70, size=24)[:keep]:
            write_map(folder / f"{topomap.run}.json", topomap)

    return write
