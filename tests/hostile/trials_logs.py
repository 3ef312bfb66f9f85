"""Hostile logs: every generator of `logs_*.py`, read by the command."""

from __future__ import annotations

import importlib
import json
import random
import shutil
import tempfile
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import logs_sensors
from case import Case, Generator, writers
from judge import counts, halves, left_overs, print_of
from sandbox import Budget, Outcome, command, run
from trials import Ground, Trial, Tried, ingest, judged

TIMES = 20
"""A hostile log may cost so many times the CPU time of a sound one of its size."""

MEMORY_MB = 300


def generators() -> Iterator[tuple[str, Generator]]:
    """All generators, by the name of their class."""
    for path in sorted(Path(__file__).parent.glob("logs_*.py")):
        yield from importlib.import_module(path.stem).CASES.items()


@cache
def _clean(kind: str) -> tuple[float, float]:
    """CPU time of reading a sound log of a kind: a small one [s], and per byte of a large one [s].

    Detections are few, for loop closure costs far more than reading.
    """
    took, size = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number, count in enumerate(SIZES[kind]):
            if kind == "grid":
                log = logs_sensors.sound(count, folder)
            else:
                drive = writers().drive(count, count // 30)
                log = writers().mcap(folder / f"{count}.mcap", drive, compression="NONE")
            calls = [ingest(folder / f"ws{number}{k}", log) for k in range(3)]
            took.append(min(run(call, folder).cpu_s for call in calls))
            size.append(log.stat().st_size)
    return took[0], max(0.0, (took[1] - took[0]) / (size[1] - size[0]))


SIZES = {"detections": (600, 30_000), "grid": (200, 800)}
"""Messages, and cells across, of small and large sound logs."""


def budget(log: Path, kind: str) -> Budget:
    """What reading a log may take: in proportion to its size, whatever it claims to hold."""
    files = [log] if log.is_file() else [p for p in log.rglob("*") if p.is_file()]
    small, per_byte = _clean(kind)
    cpu_s = TIMES * (small + per_byte * sum(file.stat().st_size for file in files))
    return Budget(cpu_s, MEMORY_MB, 10 * cpu_s + 60)


def _one_log(generator: Generator, ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """The log alone (mostly), among sound ones, or only looked at."""
    place = folder / "logs"
    place.mkdir()
    case = generator(rng, place)
    before = print_of(place)
    how = rng.random()
    workspace = folder / "ws"
    if how < 0.05:
        outcome = run(command(["info", case.log]), folder, budget(case.log, case.kind))
        problem = ""
    elif how < 0.15:
        shutil.copy(ground.logs / "a.mcap", place / "a.mcap")
        outcome = run(
            ingest(workspace, case.log, place / "a.mcap"), folder, budget(case.log, case.kind)
        )
        problem = _other_lost(ground, workspace)
        (place / "a.mcap").unlink()
    else:
        outcome = run(ingest(workspace, case.log), folder, budget(case.log, case.kind))
        problem = _accounted(case, workspace, outcome)
    after = "the log itself was changed" if print_of(place) != before else ""
    litter = "temporary files stay" if any((folder / "tmp").iterdir()) else ""
    return judged(
        [outcome], case.note, problem, halves(workspace), left_overs(workspace), after, litter
    )


def _other_lost(ground: Ground, workspace: Path) -> str:
    path = workspace / "maps" / "a.json"
    same = path.exists() and path.read_bytes() == ground.maps["a"]
    return "" if same else "another log of the same call was lost"


def _accounted(case: Case, workspace: Path, outcome: Outcome) -> str:
    """Every message is used, or counted as lost."""
    found, warnings = 0, outcome.err.splitlines()
    for path in (workspace / "maps").glob("*.json"):
        graph = json.loads(path.read_bytes())["graph"]
        uses = (graph["source"].get(use, {}) for use in ("odometry", "junctions"))
        found = sum(use.get("messages", 0) for use in uses)
        warnings = graph["warnings"]
    return counts(found, warnings, case.intact, case.lost)


TRIALS: dict[str, Trial] = {name: partial(_one_log, generator) for name, generator in generators()}
"""By class."""
