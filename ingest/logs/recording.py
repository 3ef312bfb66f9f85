"""The files of one recording at a path: formats by content, folders, names, fingerprints."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...topology.errors import LogError
from ..remote.path import LogPath, RemotePath, log_path
from .bag import MAGIC as BAG_MAGIC
from .bag import BagFile
from .inflate import WINDOW_BYTES, ZSTD_MAGIC
from .mcap import MAGIC as MCAP_MAGIC
from .mcap import McapFile
from .messages import UNWANTED, Container, Findings, printable
from .metadata import BAG_INFORMATION, METADATA_BYTES, Metadata, parse_metadata
from .saved_map import is_saved_map, saved_map_files
from .split_recordings import (
    SUFFIX,
    is_path_of_parts,
    name_of_parts,
    path_of_parts,
    split_recordings,
)
from .sqlite import MAGIC as SQLITE_MAGIC
from .sqlite import SqliteFile

METADATA = "metadata.yaml"
NOTES = 12
"""Limit on missing or unexpected files that are named."""
_NAMED = re.compile(r"\.(mcap|bag|db3|bag\.active)(\.(zstd|zst))?$", re.IGNORECASE)

WHOLE_BYTES = 1 << 26
SAMPLE_BYTES = 1 << 16
SAMPLES = 256
"""Fingerprints hash files of up to WHOLE_BYTES whole, and SAMPLES blocks of SAMPLE_BYTES of larger
ones."""

UNPACKED_RATIO = 1000
UNPACKED_BYTES = 1 << 28
"""Limit on the unpacked size of a file compressed as a whole: 256 MiB, or 1000 times its size."""


@dataclass(frozen=True, slots=True)
class Recording:
    """The files of one run in order, with notes on missing or unexpected ones.

    declared: message count of the bag's metadata, None without any.
    """

    path: LogPath
    files: tuple[LogPath, ...]
    notes: tuple[str, ...] = ()
    declared: int | None = None

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(file.stat().st_size for file in self.files)


def sniff(path: LogPath) -> str | None:
    """The format of a file by its first bytes: "mcap", "bag", "sqlite3", "zstd", or None."""
    if isinstance(path, RemotePath):
        head = path.magic()
    else:
        try:
            with path.open("rb") as file:
                head = file.read(16)
        except OSError:
            return None
    for format_name, magic in (
        ("mcap", MCAP_MAGIC),
        ("bag", BAG_MAGIC),
        ("sqlite3", SQLITE_MAGIC),
        ("zstd", ZSTD_MAGIC),
    ):
        if head.startswith(magic):
            return format_name
    return None


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
    if _is_folder(path):
        return _folder(path)
    if not path.exists():
        parts = _parts_at(path) if isinstance(path, Path) and is_path_of_parts(path) else ()
        if parts:
            return Recording(path, parts)
        raise LogError(f"{path}: no such file or folder")
    if not path.is_file():
        raise LogError(f"{path}: is neither a file nor a folder")
    if path.stat().st_size == 0:
        raise LogError(f"{path}: the file is empty; was the recorder stopped before it wrote?")
    if isinstance(path, Path):
        try:
            path.open("rb").close()
        except OSError as error:
            raise LogError(f"{path}: cannot be opened ({error.strerror})") from error
    if is_saved_map(path):
        return Recording(path, saved_map_files(path))
    if not _may_be_log(path):
        raise LogError(
            f"{path}: is no log; an MCAP file, a ROS 1 bag (format 2.0), a ROS 2 bag or a saved "
            "map (map.yaml) is needed"
        )
    return Recording(path, (path,))


def log_exists(path: Path) -> bool:
    """Whether there is something at a log's path, or the parts of a split recording."""
    return path.exists() or (is_path_of_parts(path) and bool(_parts_at(path)))


def _may_be_log(path: LogPath) -> bool:
    """Whether a local file begins like a log; True for remote ones, which are only checked when
    read."""
    return isinstance(path, RemotePath) or sniff(path) is not None


def _is_folder(path: LogPath) -> bool:
    try:
        return path.is_dir()
    except OSError as error:  # within a folder that may not be entered, for instance
        raise LogError(f"{path}: cannot be opened ({error.strerror})") from error


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
    for file in recording.files:
        if isinstance(file, RemotePath):
            size, tag, modified_s = file.state
            told = tag or modified_s or file.tail()
            digest.update(f"{file}\0{size}\0{told!r}\0".encode())
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


def find_logs(paths: Sequence[LogPath], *, separate: bool = False) -> list[LogPath]:
    """Every log at or below the given paths, sorted, each once.

    A ROS 2 bag folder is one log, and so are, unless separate, the parts of a split recording
    (`NAME_0`, `NAME_1`, …, each beginning where the one before ended): its path is the folder's if
    nothing else is there, else `NAME_*`. Below a folder, files are logs by content or, so that
    broken ones are reported, by name; hidden files are skipped; a folder that cannot be listed is
    returned itself, and reading it raises the error. In a bucket, files are logs by name alone, and
    parts make one log in a folder of their own only. A path given directly is returned as it is.

    Raises LogError for a path that does not exist and for a folder without any log.
    """
    found: dict[LogPath, None] = {}
    for path in map(log_path, paths):
        if not _is_folder(path):
            recording_at(path)
            found[path] = None
            continue
        if isinstance(path, RemotePath):
            path.read_all_named(METADATA)
        below = list(_below(path, separate))
        if not below:
            raise LogError(
                f"{path}: no log in this folder (MCAP, ROS 1 bag, ROS 2 bag or map.yaml)"
            )
        found |= dict.fromkeys(below)
    local = sorted(path for path in found if isinstance(path, Path))
    return [*local, *sorted(path for path in found if isinstance(path, RemotePath))]


def with_parts_joined(files: Sequence[LogPath]) -> list[LogPath]:
    """The files; where all parts of a split recording are among them, its path (`find_logs`) in
    place of theirs."""
    given: dict[Path, list[LogPath]] = {}
    for file in files:
        if isinstance(file, Path) and file.is_file():
            given.setdefault(file.parent, []).append(file)
    instead: dict[LogPath, LogPath] = {}
    for folder, named in given.items():
        if all(len(parts) == 1 for parts in split_recordings(named, span=None)):
            continue
        for log in _listed(folder, separate=False)[0]:
            with suppress(LogError, OSError):  # reading the files will say why
                if isinstance(log, Path) and not log.is_file() and not _is_bag_folder(log):
                    parts = recording_at(log).files
                    instead |= dict.fromkeys(parts, log) if set(parts) <= set(named) else {}
    return list(dict.fromkeys(instead.get(file, file) for file in files))


def _below(folder: LogPath, separate: bool) -> Iterator[LogPath]:
    # No recursion: folders can be nested deeper than Python's stack.
    waiting = [folder]
    while waiting:
        logs, folders = _listed(waiting.pop(), separate)
        yield from logs
        waiting += folders


def _listed(folder: LogPath, separate: bool) -> tuple[list[LogPath], list[LogPath]]:
    """The logs directly in a folder, and the folders to search."""
    try:
        entries = _entries(folder)
        if _is_bag_folder(folder):
            return [folder], []
        files = [entry for entry in entries if entry.is_file() and _is_log(entry)]
        folders = [entry for entry in entries if entry.is_dir() and not entry.is_symlink()]
    except (OSError, LogError):
        return [folder], []
    if not separate:
        files = _with_parts_as_one(folder, files)
    # Broken links, and devices or pipes, which must not be opened: reading reports them.
    others = [e for e in entries if not e.is_file() and not e.is_dir() and _NAMED.search(e.name)]
    return [*files, *others], folders


def _entries(folder: LogPath) -> list[LogPath]:
    """Entries of a folder that are not hidden, by name."""
    shown = (entry for entry in folder.iterdir() if not entry.name.startswith("."))
    return sorted(shown, key=lambda entry: entry.name)


def _is_bag_folder(folder: LogPath) -> bool:
    """Whether a folder is one ROS 2 bag: data sets also have files named metadata.yaml."""
    path = folder / METADATA
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return BAG_INFORMATION.encode() in file.read(METADATA_BYTES)


def _is_log(path: LogPath) -> bool:
    """Whether a file is a log by content, or by name, so that broken logs are reported.

    Remote files are checked by name only.
    """
    if isinstance(path, RemotePath):
        return _is_part(path)
    named = _NAMED.search(path.name)
    kind = sniff(path)
    if kind in ("sqlite3", "zstd"):
        return named is not None
    return kind is not None or named is not None or is_saved_map(path)


def _with_parts_as_one(folder: LogPath, files: Sequence[LogPath]) -> list[LogPath]:
    """The logs of a folder, split recordings as one; in a bucket only one with no others beside."""
    groups = split_recordings(files, _span)
    if len(groups) == 1 and len(files) > 1:
        return [folder]
    out: list[LogPath] = []
    for first, *others in groups:
        if others and isinstance(first, Path):
            out.append(path_of_parts(first))
        else:
            out += [first, *others]
    return out


def _parts_at(path: Path) -> tuple[LogPath, ...]:
    """The parts of the split recording that a path stands for; their times were compared when they
    were found."""
    try:
        files = [entry for entry in _entries(path.parent) if entry.is_file() and _is_log(entry)]
    except OSError:
        return ()
    for first, *others in split_recordings(files, span=None):
        if others and isinstance(first, Path) and path_of_parts(first) == path:
            return first, *others
    return ()


def _span(path: LogPath) -> tuple[int, int] | None:
    """First and last log time of a part, None if it has none or is compressed as a whole.

    An unfinished part has no index and is read through. A broken one has no times; reading it later
    reports why.
    """
    if sniff(path) in (None, "zstd"):
        return None
    try:
        return _times(container(path))
    except (LogError, OSError):
        return None


def _times(log: Container) -> tuple[int, int] | None:
    findings = Findings()
    survey = log.survey()
    if survey is not None:
        return survey.start_ns, survey.end_ns
    for _ in log.blocks(lambda _: UNWANTED, findings):
        raise AssertionError("nothing was wanted")
    if findings.first_ns is None or findings.last_ns is None:
        return None
    return findings.first_ns, findings.last_ns


def container(path: LogPath, by_index: bool = True) -> Container:
    """The reader for one file; raises LogError if it is no log.

    by_index: whether to believe the file's index, if there is a sound one.
    """
    return _container(path, sniff(path), by_index)


def _container(path: LogPath, kind: str | None, by_index: bool) -> Container:
    if kind == "mcap":
        return McapFile(path, by_index)
    if kind == "bag":
        return BagFile(path, by_index)
    if kind == "sqlite3":
        return SqliteFile(_here(path, "a database can only be read as a whole"))
    raise LogError(f"{path}: is no log; an MCAP file, a ROS 1 bag or a ROS 2 bag is needed")


@contextmanager
def opened(path: LogPath, by_index: bool = True) -> Iterator[Container]:
    """The reader for one file; a file compressed as a whole is unpacked into a temporary file
    meanwhile."""
    kind = sniff(path)
    if kind != "zstd":
        yield _container(path, kind, by_index)
        return
    packed = _here(path, "a file that is compressed as a whole can only be read as a whole")
    with tempfile.TemporaryDirectory(prefix="topobatch-") as folder:
        yield container(_unpack(packed, Path(folder) / SUFFIX.sub("", path.name)), by_index)


def _here(path: LogPath, why: str) -> Path:
    """A local path; LogError for a remote one."""
    if isinstance(path, RemotePath):
        raise LogError(f"{path}: {why}; copy it here, or convert it to MCAP (`ros2 bag convert`)")
    return path


def _unpack(path: Path, target: Path) -> Path:
    import zstandard

    written, most = 0, max(UNPACKED_BYTES, UNPACKED_RATIO * path.stat().st_size)
    with path.open("rb") as source, target.open("wb") as sink:
        reader = zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES).stream_reader(source)
        try:
            while piece := reader.read(1 << 20):
                written += len(piece)
                if written > most:
                    raise LogError(f"{path}: inflates to more than {most >> 20} MiB")
                sink.write(piece)
        except zstandard.ZstdError:
            # The part before the damage is read; the walk reports the truncation.
            sink.flush()
    return target


def _folder(path: LogPath) -> Recording:
    """The files of a bag folder: those named by metadata.yaml, and any other logs."""
    notes: list[str] = []
    try:
        entries = sorted((e for e in path.iterdir() if e.is_file()), key=_natural)
    except OSError as error:
        raise LogError(f"{path}: cannot be listed ({error.strerror})") from error
    files = [entry for entry in entries if _is_part(entry)]
    metadata = Metadata([], None)
    if (path / METADATA).is_file():
        metadata = _metadata(path / METADATA, notes)
        there = {file.name for file in files}
        missing = [
            f"{METADATA} names {name}, which is missing or no log"
            for name in metadata.files
            if name not in there and name + ".zstd" not in there
        ]
        notes += _some(missing, "also names")
    # A file beside its compressed copy has the same messages.
    names = {file.name for file in files}
    files = [
        f
        for f in files
        if _SUFFIX_ZSTD.sub("", f.name) == f.name or _SUFFIX_ZSTD.sub("", f.name) not in names
    ]
    if metadata.files:
        known = {_SUFFIX_ZSTD.sub("", name) for name in metadata.files}
        strangers = [
            f"{METADATA} does not name {printable(file.name)}, which is read all the same"
            for file in files
            if _SUFFIX_ZSTD.sub("", file.name) not in known
        ]
        notes += _some(strangers, "does not name")
    if not files:
        raise LogError(f"{path}: the folder holds no log files; a bag folder or a file is needed")
    return Recording(path, tuple(files), tuple(notes), metadata.messages)


def _is_part(path: LogPath) -> bool:
    """Whether a file of a bag folder is a log: local ones by content, remote ones by name."""
    if isinstance(path, RemotePath):
        return _NAMED.search(path.name) is not None
    return sniff(path) is not None


_SUFFIX_ZSTD = re.compile(r"\.(zstd|zst)$")


def _natural(path: LogPath) -> tuple[list[tuple[int, str]], str]:
    """Sort key by which part 10 comes after part 9."""
    pieces = re.split(r"(\d+)", path.name)
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in pieces], path.name


def _metadata(path: LogPath, notes: list[str]) -> Metadata:
    """The content of metadata.yaml; if it is unreadable, a note is added and the folder's files are
    used."""
    try:
        if path.stat().st_size > METADATA_BYTES:
            raise ValueError("it is implausibly long")
        return parse_metadata(path.read_text("utf-8", "replace"))
    except ValueError as error:
        notes.append(f"{METADATA} cannot be read ({error}); all files are used")
    except OSError as error:
        notes.append(f"{METADATA} cannot be read ({error.strerror}); all files are used")
    return Metadata([], None)


def _some(notes: list[str], what: str) -> list[str]:
    """The first NOTES notes, and the number of further ones."""
    more = len(notes) - NOTES
    return [*notes[:NOTES], f"{METADATA} {what} {more} further files"] if more > 0 else notes
