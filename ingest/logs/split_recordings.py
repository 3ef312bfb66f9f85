"""Split recordings: the parts `run_0.bag`, `run_1.bag`, … of one recording, told by names and
times.

`rosbag record --split` leaves them beside each other, without the metadata of a ROS 2 bag.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from ..remote.path import LogPath
from .log_file import SUFFIX, is_log

_PART = re.compile(r"^(?P<stem>.*?)_?(?P<begun>\d{4}(-\d\d){5})?_(?P<number>\d+)$")
"""Name of a part; ROS 1 puts its start time before its number."""

_ALL = "_*"
"""What stands for the numbers of all parts in the path of a split recording."""

GAP_NS = 5 * 10**9
"""Longest gap between two parts of one recording."""

OVERLAP_NS = 10**9 // 2
"""Longest overlap of two parts: messages in flight while the recorder changes files."""

Span = Callable[[LogPath], tuple[int, int] | None]
"""First and last log time of a file; None if it has none."""


def split_recordings(files: Sequence[LogPath], span: Span | None) -> list[list[LogPath]]:
    """The files of a folder by recording: the parts of one in order, others alone.

    Parts have one stem and format, are numbered from 0 without a gap, and each begins where the one
    before ended. A sequence that misses any of that is no split recording, and its files are single
    ones. Without `span` their times are not compared.
    """
    numbered: dict[tuple[str, str], list[tuple[str, int, LogPath]]] = {}
    single = []
    for file in files:
        bare = SUFFIX.sub("", file.name)
        part = _PART.match(bare)
        if part is None:
            single.append([file])
            continue
        kind = file.name[len(bare) :].lower().split(".")[1:2]
        key = part["stem"], "".join(kind)
        numbered.setdefault(key, []).append((part["begun"] or "", int(part["number"]), file))
    for parts in numbered.values():
        for sequence in _sequences(sorted(parts, key=lambda part: part[:2])):
            if _follow_each_other(sequence, span):
                single.append([file for _, _, file in sequence])
            else:
                single += [[file] for _, _, file in sequence]
    return sorted(single, key=lambda recording: recording[0])


def _sequences(parts: list[tuple[str, int, LogPath]]) -> list[list[tuple[str, int, LogPath]]]:
    """Numbered parts, cut before each number 0."""
    out: list[list[tuple[str, int, LogPath]]] = []
    for part in parts:
        if part[1] == 0 or not out:
            out.append([])
        out[-1].append(part)
    return out


def _follow_each_other(sequence: list[tuple[str, int, LogPath]], span: Span | None) -> bool:
    if [number for _, number, _ in sequence] != list(range(len(sequence))):
        return False
    if span is None or len(sequence) == 1:
        return True
    before: int | None = None
    for _, _, file in sequence:
        found = span(file)
        if found is None:
            return False
        if before is not None and not -OVERLAP_NS <= found[0] - before <= GAP_NS:
            return False
        before = found[1]
    return True


def path_of_parts(first: Path) -> Path:
    """The path that stands for a split recording: that of its first part, with * for the number."""
    bare = SUFFIX.sub("", first.name)
    stem = bare.rpartition("_")[0]
    return first.parent / f"{stem}{_ALL}{first.name[len(bare) :]}"


def is_path_of_parts(path: Path) -> bool:
    """Whether a path may stand for a split recording (`path_of_parts`)."""
    return SUFFIX.sub("", path.name).endswith(_ALL)


def name_of_parts(path: Path) -> str:
    """The name of a split recording by its path: what its parts' names have before the number."""
    return SUFFIX.sub("", path.name).removesuffix(_ALL) or path.parent.name


def entries(folder: LogPath) -> list[LogPath]:
    """Entries of a folder that are not hidden, by name."""
    shown = (entry for entry in folder.iterdir() if not entry.name.startswith("."))
    return sorted(shown, key=lambda entry: entry.name)


def parts_at(path: Path) -> tuple[LogPath, ...]:
    """The parts of the split recording that a path stands for, none if it stands for none; their
    times were compared when they were found."""
    if not is_path_of_parts(path):
        return ()
    try:
        files = [entry for entry in entries(path.parent) if entry.is_file() and is_log(entry)]
    except OSError:
        return ()
    for first, *others in split_recordings(files, span=None):
        if others and isinstance(first, Path) and path_of_parts(first) == path:
            return first, *others
    return ()
