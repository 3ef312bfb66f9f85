"""What a try is, and what tries share: sound logs, their workspace, how calls are judged."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from judge import conduct, print_of
from sandbox import Outcome, command, run

VICTIM = {"x.json": "{}", "x.rrd": "", "precious": "mine", ".topobatch-precious.tmp": "mine"}


class Tried(NamedTuple):
    """What a try found: the problem, "" if there is none; what was tried; what it took."""

    problem: str
    note: str
    cpu_s: float = 0.0
    memory_mb: float = 0.0


@dataclass(frozen=True)
class Ground:
    """Where tries take place, below `root`: sound logs and the workspace made from them."""

    root: Path

    @property
    def logs(self) -> Path:
        """Sound logs: `a.mcap`, `b.bag`, `c/` (a ROS 2 bag folder)."""
        return self.root / "logs"

    @property
    def workspace(self) -> Path:
        """The workspace of the sound logs, merged."""
        return self.root / "workspace"

    @cached_property
    def maps(self) -> dict[str, bytes]:
        """The map documents of the sound logs, by the name of their run."""
        return {p.stem: p.read_bytes() for p in (self.workspace / "maps").glob("*.json")}

    @cached_property
    def merged(self) -> bytes:
        """The merged document of the sound logs."""
        return (self.workspace / "merged.json").read_bytes()


def prepare(root: Path) -> Ground:
    """Write the sound logs and their workspace."""
    from topobatch.simulation.scenario import simulate_scenario
    from topobatch.simulation.settings import ScenarioSettings
    from topobatch.simulation.writing import write_run

    ground = Ground(root)
    settings = ScenarioSettings(
        runs=3, junctions_per_run=8, overlap=0.7, drift="low", odometry_hz=5, seed=5
    )
    simulated = simulate_scenario(settings).simulated
    ground.logs.mkdir(parents=True)
    for name, kind, one in zip("abc", ("mcap", "bag", "db3"), simulated, strict=True):
        made = write_run(root / "made" / name, one, kind)
        made.rename(ground.logs / (name + made.suffix))
    for call in (ingest(ground.workspace, ground.logs), merge(ground.workspace)):
        done = run(call, root)
        if done.code != 0:
            raise RuntimeError(f"the sound logs are refused: {done}")
    return ground


def ingest(workspace: Path, *more: str | Path) -> Callable[[], None]:
    """`topobatch ingest`, in one process."""
    return command(["ingest", *more, "-w", workspace, "-j", "1"])


def merge(workspace: Path) -> Callable[[], None]:
    """`topobatch merge --all`."""
    return command(["merge", "--all", "-w", workspace])


class Victim:
    """Files outside of the workspace that no call may touch."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        for name, text in VICTIM.items():
            (folder / name).write_text(text)
        self._print = print_of(folder)

    def touched(self) -> str:
        """ "" if everything is as it was."""
        return "" if print_of(self.folder) == self._print else "a file outside was touched"


def judged(outcomes: Sequence[Outcome], note: str, *problems: str) -> Tried:
    """The try that made these calls; problems that only it can see come last."""
    found = [*(conduct(outcome) for outcome in outcomes), *problems]
    return Tried(
        next((problem for problem in found if problem), ""),
        note,
        max(outcome.cpu_s for outcome in outcomes),
        max(outcome.memory_mb for outcome in outcomes),
    )


def copied(ground: Ground, folder: Path) -> Path:
    """The workspace of the sound logs once more, to be spoilt."""
    return Path(shutil.copytree(ground.workspace, folder / "ws"))


Trial = Callable[[Ground, random.Random, Path], Tried]
"""One try, in an empty folder."""
