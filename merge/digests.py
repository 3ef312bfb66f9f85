"""Digests: what is kept is found again by the content of all that it follows from."""

from __future__ import annotations

import hashlib

import numpy as np

from ..topology.topomap import TopoMap

DIGEST = 16
"""Bytes of a digest: two contents in 2⁶⁴ share one."""

NOT_CONTENT = frozenset({"run", "frame", "closures", "info", "turning_points"})
"""What a map says about itself and matching never asks."""


def digested(*parts: bytes) -> bytes:
    """16 bytes that are the same for the same bytes, one part after the other."""
    return hashlib.blake2b(b"".join(parts), digest_size=DIGEST).digest()


def digest_of(topomap: TopoMap) -> bytes:
    """16 bytes that are the same for maps of the same content, whatever the run is called."""
    out = hashlib.blake2b(digest_size=DIGEST)
    for name in TopoMap.__dataclass_fields__:
        if name not in NOT_CONTENT:
            out.update(f"{name}:".encode())
            _feed(out, getattr(topomap, name))
    return out.digest()


def _feed(out: hashlib.blake2b, value: object) -> None:
    if isinstance(value, np.ndarray):
        out.update(f"{value.dtype.str}{value.shape}".encode())
        out.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
        out.update(str([len(part) for part in value]).encode())
        out.update(np.concatenate(value).tobytes())
    elif hasattr(value, "offsets"):
        _feed(out, value.offsets)
        _feed(out, np.asarray(value.values))  # type: ignore[attr-defined]
    else:
        out.update(repr(value).encode())


class Digests:
    """Digests of maps, each worked out once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[TopoMap, bytes]] = {}

    def __call__(self, topomap: TopoMap) -> bytes:
        """`digest_of`."""
        if id(topomap) not in self._known:
            self._known[id(topomap)] = topomap, digest_of(topomap)
        return self._known[id(topomap)][1]
