"""Digests: results are cached by the content of all that they follow from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from ..topology.ragged import Ragged
from ..topology.topomap import TopoMap

DIGEST = 16
"""Bytes of a digest: a collision is expected after 2⁶⁴ contents."""

NOT_CONTENT = frozenset({"run", "frame", "closures", "info", "turning_points", "views"})
"""Fields of a map that matching does not use; and its views, which are content where there are
any."""


def digested(*parts: bytes) -> bytes:
    """A 16-byte digest of the concatenated parts."""
    return hashlib.blake2b(b"".join(parts), digest_size=DIGEST).digest()


@cache
def program_digest(*folders: str) -> bytes:
    """A 16-byte digest of all code in some folders, because a version number might be forgotten."""
    root = Path(__file__).parents[1]
    paths = [path for folder in folders for path in sorted((root / folder).rglob("*.py"))]
    return digested(*(p.relative_to(root).as_posix().encode() + p.read_bytes() for p in paths))


def digest_of(topomap: TopoMap) -> bytes:
    """A 16-byte digest of a map's content, independent of the name of its run."""
    parts: list[bytes] = []
    for name, label in _CONTENT:
        parts.append(label)
        parts += _parts(getattr(topomap, name))
    if len(topomap.views):
        parts += [b"views:", *_parts(topomap.views.pose), *_parts(topomap.views.cells)]
    return digested(*parts)


_CONTENT = [
    (name, f"{name}:".encode()) for name in TopoMap.__dataclass_fields__ if name not in NOT_CONTENT
]


def _parts(value: object) -> Iterator[bytes]:
    if isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}".encode()
        yield value.tobytes()
    elif isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
        yield str([*map(len, value)]).encode()
        yield np.concatenate(value).tobytes()
    elif isinstance(value, Ragged):
        yield from _parts(value.offsets)
        yield from _parts(np.asarray(value.values))
    else:
        yield repr(value).encode()
