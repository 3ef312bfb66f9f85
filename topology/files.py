"""Reading and atomic writing of documents: no opening of FIFOs or devices, no half-written
files."""

from __future__ import annotations

import json
import os
import re
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from io import BufferedReader
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic_core import from_json, to_json

from .errors import DocumentError

LARGEST_BYTES = 1 << 30
"""Upper bound of a document's size: one junction with its corridors takes about 1 kB."""

LEFT_OVER = re.compile(r"\.topobatch-\w{8}\.tmp")
"""Names of the temporary files of `write_atomically`; only a killed process leaves any behind."""


WRITTEN_TOGETHER = 1000
"""Entries of an iterator that are encoded at once."""


def encoded(value: Any) -> bytes:
    """A value as JSON; ValueError where it holds what JSON cannot express (NaN, infinity)."""
    text = to_json(value)
    if b"NaN" in text or b"Infinity" in text:
        json.dumps(value, allow_nan=False)  # which tells numbers from words
    return text


def read_json(path: Path) -> Any:
    """A parsed JSON file, or a DocumentError that names it: see `document_bytes` and `parsed`."""
    return parsed(document_bytes(path), path)


def parsed(data: bytes, path: Path) -> Any:
    """The value of JSON text, or a DocumentError that names `path`.

    Refused are nesting deeper than 200, text that is not UTF-8 or has lone surrogates, NaN and
    Infinity.
    """
    try:
        return from_json(data, allow_inf_nan=False)
    except ValueError as error:
        raise DocumentError(f"{path}: is not JSON: {error}") from error


def document_bytes(path: Path) -> bytes:
    """The bytes of a document. DocumentError on what is not a regular file (links, FIFOs, devices),
    cannot be read, or is larger than `LARGEST_BYTES`."""
    try:
        return read_bytes(path)
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_bytes(path: Path) -> bytes:
    """The bytes of a document; raises as `opened`, and DocumentError if it is larger than
    `LARGEST_BYTES`."""
    with opened(path) as file:
        if os.fstat(file.fileno()).st_size > LARGEST_BYTES:
            raise DocumentError(f"{path}: is larger than {LARGEST_BYTES >> 30} GiB")
        return file.read()


def opened(path: Path) -> BufferedReader:
    """A regular file opened for reading, without following links or blocking on FIFOs. Raises
    DocumentError on what is not a regular file, OSError where it cannot be read."""
    if not stat.S_ISREG(os.lstat(path).st_mode):
        raise DocumentError(f"{path}: is a {kind_of(path)}, not a document; remove it")
    # Whoever puts something else there meanwhile is refused as well.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    return open(os.open(path, flags | getattr(os, "O_BINARY", 0)), "rb")


def kind_of(path: Path) -> str:
    """The kind of file at a path, in a word."""
    mode = os.lstat(path).st_mode
    kinds = {stat.S_IFREG: "file", stat.S_IFDIR: "folder", stat.S_IFLNK: "link"}
    return kinds.get(stat.S_IFMT(mode), "FIFO, a device or a socket")


def write_json(path: Path, doc: Any) -> None:
    """Write a document atomically: after a crash either the old file or the new one is there,
    whole.

    Values of the top-level dict that are iterators are consumed and written in parts.
    """

    def fill(temporary: Path) -> None:
        with temporary.open("wb") as file:
            file.writelines(_json(doc))

    write_atomically(path, fill)


def _json(doc: Any) -> Iterator[bytes]:
    if isinstance(doc, dict) and any(isinstance(part, Iterator) for part in doc.values()):
        before = b"{"
        for key, part in doc.items():
            yield b"%b%b:" % (before, encoded(key))
            yield from _listed(part) if isinstance(part, Iterator) else [encoded(part)]
            before = b","
        yield b"}\n"
    else:
        yield encoded(doc) + b"\n"


def _listed(entries: Iterator[Any]) -> Iterator[bytes]:
    before = b"["
    while some := list(islice(entries, WRITTEN_TOGETHER)):
        yield before + encoded(some)[1:-1]
        before = b","
    yield b"]" if before == b"," else b"[]"


def write_text(path: Path, text: str) -> None:
    """Write a text atomically, as UTF-8."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then move it there in one step."""
    write_together({path: write})


def write_together(writes: Mapping[Path, Callable[[Path], object]]) -> None:
    """Write several files: all are filled before the first is moved to its place.

    If one cannot be filled (a full disk), none is moved. They are moved in the order given.
    """
    with ExitStack() as stack:
        filled = {}
        for path, write in writes.items():
            with _named(path):
                filled[path] = stack.enter_context(_temporary(path.parent))
                write(filled[path])
                filled[path].chmod(0o666 & ~_umask())
        for path, temporary in filled.items():
            with _named(path):
                os.replace(temporary, path)


@contextmanager
def _temporary(folder: Path) -> Iterator[Path]:
    """An empty temporary file, removed afterwards unless it was moved."""
    folder.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".topobatch-", suffix=".tmp", dir=folder)
    os.close(handle)
    try:
        yield Path(name)
    finally:
        Path(name).unlink(missing_ok=True)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Make OSErrors name the file that was to be written instead of its temporary file."""
    try:
        yield
    except OSError as error:
        name = error.filename
        if name is None or LEFT_OVER.fullmatch(Path(os.fsdecode(name)).name):
            error.filename = str(path)
            error.filename2 = None
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
