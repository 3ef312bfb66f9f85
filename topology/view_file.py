"""The views of a map as a file beside its document, `maps/<run>.views`, and back.

The document states their number and a digest of their content, so that views are never taken for
those of another map. Same views, same bytes.
"""

from __future__ import annotations

import hashlib
import lzma
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .digits import METRES, TURN
from .errors import DocumentError
from .files import document_bytes
from .map_schema import FARTHEST_M
from .topomap import TopoMap
from .views import FREE, SIDE, WALL, Views

HEAD = b"topobatch.views/1\n"
"""The first bytes of a file: the rest is an xz stream of times, poses, and one bit per cell for
walls and for free space. Of 68 views of an office it takes 22 kB, where zlib takes 29 kB."""
PER_VIEW = 4 * 8 + 2 * SIDE * SIDE // 8
"""Bytes of a view before they are compressed: time and pose as 8-byte numbers, two bits a cell."""
PER_UNIT = 10.0 ** np.array([METRES, METRES, TURN])
"""Steps in which a pose is written, per metre and radian: as in documents."""
MEMORY = 1 << 27
"""Bytes that unpacking may take beside its result; what we write needs 9 MB."""

Record = dict[str, Any]
"""`count` and `digest` of views, as they stand in the document."""


def views_path(document: Path) -> Path:
    """The file of the views of a map document."""
    return document.with_suffix(".views")


def record_of(views: Views) -> Record:
    """The record of a map's views in its document."""
    content = _content(views)
    return {"count": len(views), "digest": hashlib.blake2b(content, digest_size=16).hexdigest()}


def to_bytes(views: Views) -> bytes:
    """A file of views; positions are rounded to millimetres, turns to microradians."""
    return HEAD + lzma.compress(_content(views))


def from_bytes(data: bytes, record: Record) -> Views:
    """The views of a file. ValueError if they are not those of the record."""
    count = record["count"]
    size = count * PER_VIEW
    if not data.startswith(HEAD):
        raise ValueError("is no file of views")
    try:
        content = lzma.LZMADecompressor(memlimit=MEMORY).decompress(data[len(HEAD) :], size + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"is damaged: {error}") from error
    if hashlib.blake2b(content, digest_size=16).hexdigest() != record["digest"]:
        raise ValueError("is damaged, or of another map")
    numbers = np.frombuffer(content, "<i8", 4 * count).reshape(4, count)
    bits = np.frombuffer(content, np.uint8, offset=4 * 8 * count)
    wall, free = np.unpackbits(bits).reshape(2, count, SIDE, SIDE)
    pose = numbers[1:].T / PER_UNIT
    return Views(numbers[0], pose, WALL * wall + FREE * free)


def _content(views: Views) -> bytes:
    """Times, poses and cells as bytes, like with like, which compresses best."""
    known = np.clip(np.nan_to_num(views.pose), -FARTHEST_M, FARTHEST_M)
    pose = np.rint(known * PER_UNIT)
    numbers = np.concatenate([views.time_ns[None], pose.T.astype(np.int64)])
    bits = np.packbits(np.stack([views.cells == WALL, views.cells == FREE]))
    return numbers.astype("<i8").tobytes() + bits.tobytes()


def with_views(topomap: TopoMap, document: Path) -> TopoMap:
    """A map that was read from a document, with the views beside it. If they are lost or damaged it
    is returned without, with `TopoMap.views_lost` set."""
    record = topomap.info.get("views")
    if record is None:
        return topomap
    try:
        views = from_bytes(document_bytes(views_path(document)), record)
    except (DocumentError, ValueError):
        return topomap
    info = {key: value for key, value in topomap.info.items() if key != "views"}
    return replace(topomap, views=views, info=info)


def view_writes(document: Path, topomap: TopoMap) -> dict[Path, Callable[[Path], object]]:
    """What writes the views of a map beside its document (`files.write_together`); nothing for maps
    without views."""
    if not len(topomap.views):
        return {}
    return {views_path(document): partial(_write, data=to_bytes(topomap.views))}


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)
