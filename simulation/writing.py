"""Scenarios as files: one log per run in any container, and `truth.json` beside them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from ..topology.document import write_atomically
from ..topology.errors import UsageError
from .bag_writer import bag_bytes
from .mcap_writer import mcap_bytes
from .messages import topics_of
from .ros2_writer import write_ros2_folder
from .scenario import Scenario, SimulatedRun
from .truth import write_truth

TRUTH_FILE = "truth.json"


def _write_mcap(path: Path, simulated: SimulatedRun) -> None:
    raw = mcap_bytes(topics_of(simulated, "ros2"))
    write_atomically(path, lambda temporary: temporary.write_bytes(raw))


def _write_bag(path: Path, simulated: SimulatedRun) -> None:
    raw = bag_bytes(topics_of(simulated, "ros1"))
    write_atomically(path, lambda temporary: temporary.write_bytes(raw))


def _write_db3(path: Path, simulated: SimulatedRun) -> None:
    write_ros2_folder(path, topics_of(simulated, "ros2"), "sqlite3")


def _write_ros2_mcap(path: Path, simulated: SimulatedRun) -> None:
    write_ros2_folder(path, topics_of(simulated, "ros2"), "mcap")


FORMATS: Mapping[str, tuple[str, Callable[[Path, SimulatedRun], None]]] = MappingProxyType(
    {
        "mcap": (".mcap", _write_mcap),
        "bag": (".bag", _write_bag),
        "db3": ("", _write_db3),
        "ros2-mcap": ("", _write_ros2_mcap),
    }
)
"""Containers by name: the suffix of the log's path, and its writer. The last two are folders."""


def write_run(folder: Path, simulated: SimulatedRun, container: str = "mcap") -> Path:
    """Write the log of one run into `folder`, named after the run; its path.

    An older log of that name is replaced. UsageError if there is no such container.
    """
    if container not in FORMATS:
        raise UsageError(f"no format {container!r}: choose one of {', '.join(FORMATS)}")
    suffix, write = FORMATS[container]
    path = folder / f"{simulated.run.name}{suffix}"
    folder.mkdir(parents=True, exist_ok=True)
    write(path, simulated)
    return path


def write_scenario(
    scenario: Scenario,
    out: Path,
    formats: Sequence[str] = ("mcap",),
    progress: Callable[[Path], object] | None = None,
) -> list[Path]:
    """Write every run's log and `truth.json` into the folder `out`; the paths of the logs.

    Several formats are dealt out to the runs in turn. `progress` is told each log that is done.
    UsageError if no format is given, or one that does not exist.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        wrong = f"no format {unknown[0]!r}" if unknown else "no format given"
        raise UsageError(f"{wrong}: choose one of {', '.join(FORMATS)}")
    paths = []
    for k, simulated in enumerate(scenario.simulated):
        paths.append(write_run(out, simulated, formats[k % len(formats)]))
        if progress is not None:
            progress(paths[-1])
    write_truth(out / TRUTH_FILE, scenario.truth)
    return paths
