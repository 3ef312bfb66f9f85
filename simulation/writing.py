"""Scenarios as files: one log per run in any container, and `truth.json` beside them.

Logs are written by mcap and rosbags. The same run gives the same bytes with the same versions of
these libraries (and of SQLite, LZ4 and Zstandard), and the same messages with any version.
"""

from __future__ import annotations

import errno
import os
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Literal

from ..topology.errors import UsageError
from .messages import in_log_order, topics_of, typestore
from .scenario import Scenario, SimulatedRun
from .truth import write_truth

TRUTH_FILE = "truth.json"
METADATA = "metadata.yaml"
"""Of the folder of a ROS 2 bag."""

METADATA_VERSION: Literal[9] = 9
"""Version of metadata.yaml as in ROS 2 Jazzy."""


def _write_mcap(path: Path, simulated: SimulatedRun) -> None:
    from mcap.writer import CompressionType, Writer

    topics, store = topics_of(simulated, "ros2"), typestore("ros2")
    with path.open("xb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="topobatch")
        channels = []
        for topic in topics:
            text, _ = store.generate_msgdef(topic.type_name, ros_version=2)
            schema = writer.register_schema(topic.type_name, "ros2msg", text.encode())
            channels.append(writer.register_channel(topic.name, "cdr", schema))
        for sequence, (number, log, stamp, payload) in enumerate(in_log_order(topics)):
            writer.add_message(channels[number], log, payload, stamp, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def _write_bag(path: Path, simulated: SimulatedRun) -> None:
    from rosbags.rosbag1 import Writer

    topics, store = topics_of(simulated, "ros1"), typestore("ros1")
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        links = [writer.add_connection(t.name, t.type_name, typestore=store) for t in topics]
        for number, log, _, payload in in_log_order(topics):
            writer.write(links[number], log, payload)


def _write_ros2_folder(path: Path, simulated: SimulatedRun, storage: str) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    topics, store = topics_of(simulated, "ros2"), typestore("ros2")
    plugin = StoragePlugin[storage]
    writer = Writer(path, version=METADATA_VERSION, storage_plugin=plugin)
    if plugin is StoragePlugin.MCAP:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        links = [writer.add_connection(t.name, t.type_name, typestore=store) for t in topics]
        for number, log, _, payload in in_log_order(topics):
            writer.write(links[number], log, payload)


FORMATS: Mapping[str, tuple[str, Callable[[Path, SimulatedRun], None]]] = MappingProxyType(
    {
        "mcap": (".mcap", _write_mcap),
        "bag": (".bag", _write_bag),
        "db3": ("", partial(_write_ros2_folder, storage="SQLITE3")),
        "ros2-mcap": ("", partial(_write_ros2_folder, storage="MCAP")),
    }
)
"""Containers by name: suffix of the log's path, and writer. "db3" and "ros2-mcap" are folders."""

STORAGE: Mapping[str, str] = MappingProxyType({"db3": ".db3", "ros2-mcap": ".mcap"})
"""Suffix of the one file beside metadata.yaml, by the format of a folder."""


def write_run(folder: Path, simulated: SimulatedRun, container: str = "mcap") -> Path:
    """Write the log of one run into `folder`, named after the run; returns its path.

    An existing log of that name is replaced. Raises UsageError for an unknown container, OSError
    with the log's path if it cannot be written.
    """
    if container not in FORMATS:
        raise UsageError(f"no format {container!r}: choose one of {', '.join(FORMATS)}")
    suffix, write = FORMATS[container]
    path = folder / f"{simulated.run.name}{suffix}"
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with TemporaryDirectory(prefix=".topobatch-", suffix=".tmp", dir=folder) as made:
            log = Path(made, path.name)
            write(log, simulated)
            _move(log, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    except sqlite3.Error as error:
        raise OSError(errno.EIO, str(error), str(path)) from error
    return path


def _move(log: Path, path: Path) -> None:
    """Move a log into place, file by file, since a folder may exist already."""
    if log.is_dir():
        path.mkdir(exist_ok=True)
        for file in log.iterdir():
            os.replace(file, path / file.name)
    else:
        os.replace(log, path)


def _remove_others(folder: Path, run: str, container: str) -> None:
    """Remove the logs of a run that `write_run` left in other containers; links and whatever else a
    folder of that name holds stay."""
    bag = folder / run
    others = [
        folder / f"{run}{suffix}" for name, (suffix, _) in FORMATS.items() if name != container
    ]
    files = [path for path in others if path != bag]
    if not bag.is_symlink() and (bag / METADATA).is_file():
        inside = [bag / f"{run}{suffix}" for name, suffix in STORAGE.items() if name != container]
        inside = [path for path in inside if path.is_file()]
        files += [*inside, bag / METADATA] if inside and container not in STORAGE else inside
    for path in files:
        if path.is_file() and not path.is_symlink():
            path.unlink()
    if container not in STORAGE and bag.is_dir() and not any(bag.iterdir()):
        bag.rmdir()


def write_scenario(
    scenario: Scenario,
    out: Path,
    formats: Sequence[str] = ("mcap",),
    progress: Callable[[Path], object] | None = None,
    *,
    alone: bool = False,
) -> list[Path]:
    """Write every run's log and `truth.json` into the folder `out`; returns the paths of the logs.

    Several formats are assigned to the runs in turn. `progress` is called with each finished log.
    alone: remove logs of these runs in other formats that were written there before. Raises
    UsageError if a format is missing or unknown.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        wrong = f"no format {unknown[0]!r}" if unknown else "no format given"
        raise UsageError(f"{wrong}: choose one of {', '.join(FORMATS)}")
    paths = []
    for k, simulated in enumerate(scenario.simulated):
        container = formats[k % len(formats)]
        paths.append(write_run(out, simulated, container))
        if alone:
            _remove_others(out, simulated.run.name, container)
        if progress is not None:
            progress(paths[-1])
    write_truth(out / TRUTH_FILE, scenario.truth)
    return paths
