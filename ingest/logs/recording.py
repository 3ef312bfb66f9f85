"""The files of one recording at a path: bag folders, split recordings, names, fingerprints."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...topology.errors import LogError
from ...topology.wording import listed
from ..remote.path import SMALL_FILE_BYTES, LogPath, RemotePath, log_path
from .inflate import keep_freed_memory
from .log_file import SUFFIX, LogFile, is_named_like_log, sniff
from .messages import NOT_TOLD, Block, Findings, Passed, Progress, Want
from .metadata import Metadata, parse_metadata
from .saved_map import is_saved_map, saved_map_files
from .split_recordings import is_path_of_parts, name_of_parts, parts_at

METADATA = "metadata.yaml"
WHOLE_BYTES = 1 << 26
SAMPLE_BYTES = 1 << 16
SAMPLES = 256
"""Fingerprints hash files of up to WHOLE_BYTES whole, and SAMPLES blocks of SAMPLE_BYTES of larger
ones."""

_PACKED = re.compile(r"\.(zstd|zst)$")


@dataclass(frozen=True, slots=True)
class Recording:
    """The files of one run in order, with notes on missing or unexpected ones.

    declared: message count of the bag's metadata, None without any; passes: what each complete pass
    over all files found, added to.
    """

    path: LogPath
    files: tuple[LogFile, ...]
    notes: tuple[str, ...] = ()
    declared: int | None = None
    passes: list[Findings] = field(default_factory=list)

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(file.bytes for file in self.files)

    def blocks(self, want: Want, on_bytes: Progress | None = None) -> Iterator[Block]:
        """The wanted messages, in one pass over all files; the calls of on_bytes add up to
        `bytes`."""
        keep_freed_memory()
        findings = Findings()
        for file in self.files:
            passed = Passed(on_bytes)
            with file.opened() as log:
                yield from log.blocks(want, findings, NOT_TOLD if file.packed else passed)
            passed.passed(file.bytes)
        self.passes.append(findings)


def run_name(path: LogPath) -> str:
    """The run's name by its log: folder name, or file name without log suffixes; of a split
    recording without the number of a part."""
    path = log_path(path)
    if isinstance(path, Path) and is_path_of_parts(path) and not path.exists():
        return name_of_parts(path)
    name = path.name if path.name not in ("", "..") else path.resolve().name
    return name if path.is_dir() else SUFFIX.sub("", name) or name


def recording_at(path: LogPath) -> Recording:
    """The recording at a path; raises LogError if there is none."""
    path = log_path(path)
    if isinstance(path, RemotePath):
        path = path.fresh()  # what is read of it goes with the recording
    if is_folder(path):
        return _folder(path)
    if not path.exists():
        parts = parts_at(path) if isinstance(path, Path) else ()
        if parts:
            return Recording(path, tuple(map(LogFile, parts)))
        raise LogError(f"{path}: no such file or folder")
    if not path.is_file():
        raise LogError(f"{path}: is neither a file nor a folder")
    if path.stat().st_size == 0:
        raise LogError(f"{path}: the file is empty; was the recorder stopped before it wrote?")
    file = LogFile(path)
    if isinstance(path, Path):
        try:
            path.open("rb").close()
        except OSError as error:
            raise LogError(f"{path}: cannot be opened ({error.strerror})") from error
        if is_saved_map(path):
            return Recording(path, tuple(map(LogFile, saved_map_files(path))))
        if file.kind is None:
            raise LogError(
                f"{path}: is no log; an MCAP file, a ROS 1 bag (format 2.0), a ROS 2 bag or a "
                "saved map (map.yaml) is needed"
            )
    return Recording(path, (file,))


def is_folder(path: LogPath) -> bool:
    """Whether there is a folder; raises LogError if that cannot be found out."""
    try:
        return path.is_dir()
    except OSError as error:  # within a folder that may not be entered, for instance
        raise LogError(f"{path}: cannot be opened ({error.strerror})") from error


def log_exists(path: Path) -> bool:
    """Whether there is something at a log's path, or the parts of a split recording."""
    return path.exists() or bool(parts_at(path))


def log_size(path: LogPath) -> int:
    """Bytes of all files of a log."""
    return recording_at(path).bytes


def log_fingerprint(path: LogPath) -> str:
    """A hash that changes with the log, in a fraction of the time of reading it.

    Hashed are names and sizes of all files, the whole content of files up to 64 MiB, and 256 evenly
    spaced blocks of 64 KiB of larger ones, including the first and the last. Editing a larger file
    in place without changing its size or a sampled block is not noticed; recording, truncating,
    appending and recompressing are. In a bucket names, sizes and tags are hashed instead of
    contents; without tags times, or else the last bytes.
    """
    recording = recording_at(path)
    digest = hashlib.blake2b(digest_size=16)
    for file in (each.path for each in recording.files):
        if isinstance(file, RemotePath):
            size, tag, modified_s = file.state
            state = tag or modified_s or file.tail()
            digest.update(f"{file}\0{size}\0{state!r}\0".encode())
            continue
        for part in (file, file.with_name(file.name + "-wal")):
            if part.is_file():
                relative = part.name if part is not recording.path else ""
                digest.update(f"{relative}\0{part.stat().st_size}\0".encode())
                try:
                    _sample(part, digest)
                except OSError:
                    if part is file:
                        raise
                    digest.update(b"unreadable")  # reading the database says so
    return digest.hexdigest()


def _sample(path: Path, digest: Any) -> None:
    size = path.stat().st_size
    with path.open("rb") as file:
        if size <= WHOLE_BYTES:
            while piece := file.read(1 << 20):
                digest.update(piece)
            return
        for number in range(SAMPLES):
            file.seek((size - SAMPLE_BYTES) * number // (SAMPLES - 1))
            digest.update(file.read(SAMPLE_BYTES))


def _folder(path: LogPath) -> Recording:
    """The files of a bag folder: those named by metadata.yaml, and any other logs."""
    notes: list[str] = []
    try:
        entries = sorted((e for e in path.iterdir() if e.is_file()), key=_natural)
    except OSError as error:
        raise LogError(f"{path}: cannot be listed ({error.strerror})") from error
    # Logs are known by their content, remote ones by name.
    is_part = is_named_like_log if isinstance(path, RemotePath) else sniff
    files = [LogFile(entry) for entry in entries if is_part(entry)]
    # A file beside its compressed copy has the same messages.
    names = {file.path.name for file in files}
    files = [file for file in files if _bare(file) == file.path.name or _bare(file) not in names]
    metadata = Metadata([], None)
    if (path / METADATA).is_file():
        metadata = _metadata(path / METADATA, notes)
        there = {_bare(file) for file in files} | names
        if missing := [name for name in metadata.files if name not in there]:
            verb = "is" if len(missing) == 1 else "are"
            notes.append(f"{METADATA} names {listed(missing)}, which {verb} missing or no log")
    if not files:
        raise LogError(f"{path}: the folder holds no log files; a bag folder or a file is needed")
    return Recording(path, tuple(files), tuple(notes), metadata.messages)


def _bare(file: LogFile) -> str:
    """Its name before it was compressed as a whole."""
    return _PACKED.sub("", file.path.name)


def _natural(path: LogPath) -> tuple[list[tuple[int, str]], str]:
    """Sort key by which part 10 comes after part 9."""
    pieces = re.split(r"(\d+)", path.name)
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in pieces], path.name


def _metadata(path: LogPath, notes: list[str]) -> Metadata:
    """The content of metadata.yaml; if it is unreadable, a note is added and the folder's files are
    used."""
    try:
        if path.stat().st_size > SMALL_FILE_BYTES:
            raise ValueError("it is implausibly long")
        return parse_metadata(path.read_text("utf-8", "replace"))
    except (ValueError, OSError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        notes.append(f"{METADATA} cannot be read ({why}); all files are used")
    return Metadata([], None)
