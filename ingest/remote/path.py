"""Addresses of logs in buckets and on web servers, with the pathlib methods that are needed.

A bucket's listing is read once and kept as a tree; what is read of an object first (its summary,
for instance) is kept with it and pickled to other processes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit, urlunsplit

from ...topology.errors import LogError, UsageError
from .source import BLOCK_BYTES, RemoteFile
from .store import Got, MissingObjectError, Stat, listed, requested, require_obstore

_REMOTE = re.compile(r"^(s3|gs|az|https?)://", re.IGNORECASE)
_LOG = re.compile(r"\.(mcap|bag|db3|active|zstd|zst)$", re.IGNORECASE)
_HEAD_FIRST = re.compile(r"\.(bag|active)$", re.IGNORECASE)

HEAD_BYTES = 2 * BLOCK_BYTES
"""Front of a bag that is read: magic and first record, which holds the index position. Writers pad
it to 4096 bytes."""

TAIL_BYTES = 1 << 15
"""Bytes first read at the end of an object. A summary has 1 to 3 kB per topic and 200 bytes per
chunk of 1 MB; the rest of a longer one is read when needed."""

SMALL_FILE_BYTES = 1 << 22
"""Largest metadata.yaml that is read: a thousand topics and files take 1 MiB."""


def is_remote(text: str) -> bool:
    """Whether a text is the address of something in a bucket or on a web server."""
    return _REMOTE.match(text) is not None


@dataclass(slots=True)
class _Node:
    """A node of a bucket's tree: an object, a folder with its entries, or nothing.

    there: whether there is an object; stat: its state, if known; end: what was read first of it.
    """

    there: bool = False
    stat: Stat | None = None
    end: Got | None = None
    children: dict[str, _Node] = field(default_factory=dict)

    def at(self, key: str) -> _Node:
        """The node below by its relative key, created if needed."""
        node = self
        for name in key.split("/") if key else ():
            node = node.children.setdefault(name, _Node())
        return node


class RemotePath:
    """A place in a bucket or on a web server.

    root: address of the store, as `s3://bucket`; key: the place in it. allow_scan: whether logs
    without an index may be read whole. Secrets of the address are not printed. Methods are those of
    pathlib.Path; they raise LogError on server errors.
    """

    __slots__ = ("_file", "_found", "allow_scan", "key", "root")

    def __init__(
        self, root: str, key: str, found: _Node | None = None, *, allow_scan: bool = False
    ) -> None:
        self.root, self.key, self._found, self.allow_scan = root, key, found, allow_scan
        self._file: RemoteFile | None = None

    @classmethod
    def parse(cls, address: str, *, allow_scan: bool = False) -> RemotePath:
        """The place of an address; UsageError if it is invalid or obstore is missing."""
        scheme, host, path, query, _ = urlsplit(address)
        if scheme.lower() not in ("http", "https"):
            # A key may hold any character: nothing in it is a query.
            root, _, key = address.partition("://")[2].partition("/")
            if not root:
                raise UsageError(f"{address}: names no bucket")
            require_obstore(address)
            folder = "/" if key.endswith("/") else ""
            return cls(f"{scheme.lower()}://{root}", key.strip("/") + folder, allow_scan=allow_scan)
        folder, _, name = path.rpartition("/")
        if not host or not name:
            raise UsageError(
                f"{_public(address)}: names no file; a web server gives no list of its files, so "
                "name each log"
            )
        require_obstore(_public(address))
        root = urlunsplit((scheme.lower(), host, folder, query, ""))
        return cls(root, unquote(name), allow_scan=allow_scan)

    # A path

    @property
    def name(self) -> str:
        """The last part of the key, or the bucket's name."""
        return self.key.rstrip("/").rpartition("/")[2] or self.root.rpartition("/")[2]

    def __str__(self) -> str:
        base = _public(self.root)
        return f"{base}/{self.key}".rstrip("/")

    def __repr__(self) -> str:
        return f"RemotePath({str(self)!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RemotePath) and (self.root, self.key) == (other.root, other.key)

    def __lt__(self, other: RemotePath) -> bool:
        return (self.root, self.key) < (other.root, other.key)

    def __hash__(self) -> int:
        return hash((self.root, self.key))

    def __reduce__(self) -> Any:
        # A folder is listed again: trees may be deeper than pickle goes.
        found = self._found if self._found is not None and not self._found.children else None
        return partial(RemotePath, allow_scan=self.allow_scan), (self.root, self.key, found)

    def __truediv__(self, name: str) -> RemotePath:
        key = f"{self.key.rstrip('/')}/{name}".lstrip("/")
        node = self._node.children.get(name, _Node())
        return RemotePath(self.root, key, node, allow_scan=self.allow_scan)

    def resolve(self) -> RemotePath:
        """This path."""
        return self

    def is_file(self) -> bool:
        """Whether there is an object; an empty one with others below only marks their folder."""
        node = self._node
        return node.there and not (node.children and self.state.size == 0)

    def is_dir(self) -> bool:
        """Whether there are objects below."""
        return bool(self._node.children)

    def is_symlink(self) -> bool:
        """False."""
        return False

    def exists(self) -> bool:
        """Whether there is an object, or one below it."""
        return self.is_file() or self.is_dir()

    def iterdir(self) -> Iterator[RemotePath]:
        """The entries of a folder."""
        return (self / name for name in self._node.children)

    def stat(self) -> Stat:
        """With `st_size`."""
        return self.state

    def open(self, mode: str = "rb") -> io.BytesIO:
        """A small file's content, for reading."""
        assert mode == "rb"
        if self.state.size > SMALL_FILE_BYTES:
            raise LogError(f"{self}: is implausibly long for what it is")
        return io.BytesIO(self.file.read(0, self.state.size))

    def read_text(self, encoding: str, errors: str) -> str:
        """A small file's content as text."""
        return self.open().read().decode(encoding, errors)

    # An object

    @property
    def state(self) -> Stat:
        """Size, tag and time of the object, requested together with the end that holds its
        index."""
        node = self._object
        if node.stat is None:
            self._first_look(node)
        assert node.stat is not None
        return node.stat

    @property
    def file(self) -> RemoteFile:
        """The object for reading; bytes read are kept as long as this path."""
        if self._file is None:
            self._file = RemoteFile(self.state.size, self._object.end, self._requested)
        return self._file

    def fresh(self) -> RemotePath:
        """The same place with no bytes but those that were read first."""
        return RemotePath(self.root, self.key, self._node, allow_scan=self.allow_scan)

    def forget(self) -> None:
        """Drop the kept bytes; they are requested again when needed."""
        self._file = None
        if self._found is not None:
            for node in (self._found, *self._found.children.values()):
                node.end = None

    def magic(self) -> bytes:
        """The first bytes, which tell the format, or the last: MCAP files end with the same
        magic."""
        node = self._object
        if node.end is None:
            self._first_look(node)
        if node.end is None:
            return b""
        start, data, stat = node.end
        ends = start + len(data) == stat.size and data[-8:-3] == b"\x89MCAP"
        return data[-8:] if ends and not _HEAD_FIRST.search(self.name) else self.file.read(0, 16)

    def tail(self) -> bytes:
        """The last bytes."""
        start = max(0, self.state.size - TAIL_BYTES)
        return self.file.read(start, self.state.size - start)

    def _first_look(self, node: _Node) -> None:
        """Request the end of the object that holds its index: the first of a bag, the last of
        others."""
        wanted: tuple[int, int] | int = TAIL_BYTES
        known, key = node.stat, self.key.rstrip("/")
        if _HEAD_FIRST.search(self.name):
            wanted = 0, HEAD_BYTES if known is None else min(known.size, HEAD_BYTES)
        if known is None or known.size > 0:
            node.end = requested(self.root, key, wanted, known, named=str(self)).result()
            node.stat = node.stat or node.end.stat

    def _requested(self, wanted: tuple[int, int]) -> Future[Got]:
        """A request for bytes of the object in its known state."""
        return requested(
            self.root, self.key.rstrip("/"), wanted, self._object.stat, named=str(self)
        )

    @property
    def _object(self) -> _Node:
        if not self._node.there:
            raise MissingObjectError(f"{self}: no such object")
        return self._node

    @property
    def _node(self) -> _Node:
        if self._found is None:
            self._found = self._looked_up()
        return self._found

    def _looked_up(self) -> _Node:
        """The node: an object if it is named like a log, else a folder, else an object."""
        http = self.root.startswith("http")
        named = bool(self.key) and not self.key.endswith("/")
        if named and (http or _LOG.search(self.key)) and (alone := self._alone()):
            return alone
        if http:
            raise LogError(f"{self}: no such file on the server")
        folder, prefix = _Node(), self.key.rstrip("/")
        skip = len(prefix) + 1 if prefix else 0
        for key, stat in listed(self.root, prefix, named=str(self)):
            if key[skip:]:
                node = folder.at(key[skip:])
                node.there, node.stat = True, stat
        if folder.children or not named or _LOG.search(self.key):
            return folder
        return self._alone() or folder

    def _alone(self) -> _Node | None:
        """The object of this name, None if there is none."""
        node = _Node(there=True)
        try:
            self._first_look(node)
        except MissingObjectError:
            return None
        return node


def _public(address: str) -> str:
    """The address without user, password and query, which may be a signature."""
    scheme, host, path, _, _ = urlsplit(address)
    if scheme not in ("http", "https"):
        return address
    return urlunsplit((scheme, host.rpartition("@")[2], path, "", ""))


LogPath = Path | RemotePath
"""The place of a log."""


def log_path(place: str | LogPath, *, allow_scan: bool = False) -> LogPath:
    """The place of a text: a local path or a remote address."""
    if isinstance(place, RemotePath):
        return place
    if isinstance(place, str) and is_remote(place):
        return RemotePath.parse(place, allow_scan=allow_scan)
    return Path(place)
