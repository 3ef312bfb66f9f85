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
from typing import Any, Literal

from ..topology.errors import UsageError
from .messages import TOPICS, messages_of, topics_of, typestore
from .scenario import Scenario, SimulatedRun
from .truth import write_truth

TRUTH_FILE = "truth.json"
METADATA_VERSION: Literal[9] = 9
"""Version of metadata.yaml as in ROS 2 Jazzy."""


def _write_mcap(path: Path, simulated: SimulatedRun) -> None:
    from mcap.writer import CompressionType, Writer

    store = typestore("ros2")
    with path.open("xb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="topobatch")
        channels = {}
        for topic in topics_of(simulated):
            text, _ = store.generate_msgdef(TOPICS[topic], ros_version=2)
            schema = writer.register_schema(TOPICS[topic], "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for sequence, (log_ns, stamp_ns, topic, payload) in enumerate(
            messages_of(simulated, "ros2")
        ):
            writer.add_message(channels[topic], log_ns, payload, stamp_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def _write_rosbag(path: Path, simulated: SimulatedRun, storage: str | None) -> None:
    """A ROS 1 bag, or the folder of a ROS 2 bag of a storage."""
    writer: Any
    if storage is None:
        from rosbags.rosbag1 import Writer as BagWriter

        writer = BagWriter(path)
        writer.set_compression(BagWriter.CompressionFormat.LZ4)
    else:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        plugin = StoragePlugin[storage]
        writer = Writer(path, version=METADATA_VERSION, storage_plugin=plugin)
        if plugin is StoragePlugin.MCAP:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    ros = "ros1" if storage is None else "ros2"
    store = typestore(ros)
    with writer:
        links = {
            topic: writer.add_connection(topic, TOPICS[topic], typestore=store)
            for topic in topics_of(simulated)
        }
        for log_ns, _, topic, payload in messages_of(simulated, ros):
            writer.write(links[topic], log_ns, payload)


FORMATS: Mapping[str, tuple[str, Callable[[Path, SimulatedRun], None]]] = MappingProxyType(
    {
        "mcap": (".mcap", _write_mcap),
        "bag": (".bag", partial(_write_rosbag, storage=None)),
        "db3": ("", partial(_write_rosbag, storage="SQLITE3")),
        "ros2-mcap": ("", partial(_write_rosbag, storage="MCAP")),
    }
)
"""Containers by name: suffix of the log's path, and writer. "db3" and "ros2-mcap" are folders."""

_FILES: Mapping[str, tuple[str, ...]] = {
    "mcap": ("{0}.mcap",),
    "bag": ("{0}.bag",),
    "db3": ("{0}/{0}.db3", "{0}/metadata.yaml"),
    "ros2-mcap": ("{0}/{0}.mcap", "{0}/metadata.yaml"),
}
"""What a run's log consists of, by container."""


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
            write(Path(made, path.name), simulated)
            for file in [p for p in Path(made).rglob("*") if p.is_file()]:
                target = folder / file.relative_to(made)
                target.parent.mkdir(exist_ok=True)
                os.replace(file, target)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    except sqlite3.Error as error:
        raise OSError(errno.EIO, str(error), str(path)) from error
    return path


def _remove_others(folder: Path, run: str, container: str) -> None:
    """Remove what `write_run` left of a run in other containers; links and whatever else a folder
    of that name holds stay."""
    bag = folder / run
    for file in {file for files in _FILES.values() for file in files} - {*_FILES[container]}:
        path = folder / file.format(run)
        if path.is_file() and not path.is_symlink() and not bag.is_symlink():
            path.unlink()
    if bag.is_dir() and not bag.is_symlink() and not any(bag.iterdir()):
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
