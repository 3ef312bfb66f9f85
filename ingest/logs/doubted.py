"""Messages of a known type with another embedded definition: which of the two is right."""

from __future__ import annotations

import numpy as np

from ...topology.arrays import IntArray
from .foxglove import RowDecoder
from .messages import Bytes
from .poses import Frames, Heads, PoseDecoder, Poses
from .wire import WireDecoder

UNIT = 1e-3
"""Tolerance of recorded unit quaternions; arbitrary bytes do not meet it."""


class DoubtedDecoder:
    """Decodes by the embedded definition or, if that never works, by the known one.

    A wrong bit in a definition can join two of its lines. The known one is only used if all
    messages tried decode by it, with unit quaternions.
    """

    def __init__(self, embedded: RowDecoder, known: WireDecoder) -> None:
        self._embedded = embedded
        self._known = known
        self._chosen: PoseDecoder | None = None

    @property
    def frames(self) -> Frames:
        """Those of the definition that works."""
        return (self._chosen or self._embedded).frames

    @property
    def failed(self) -> int:
        """Messages that could not be decoded."""
        chosen = self._known.failed if self._chosen is self._known else 0
        return self._embedded.failed + chosen

    @property
    def reason(self) -> str:
        """Why the first of them could not be decoded."""
        return self._embedded.reason or (self._chosen.reason if self._chosen else "")

    def heads(self, data: Bytes, start: IntArray, size: IntArray) -> Heads | None:
        """The bytes needed of the messages, once the known definition has proved right."""
        return self._known.heads(data, start, size) if self._chosen is self._known else None

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> Poses:
        """The poses of a batch of messages."""
        if self._chosen is not None:
            return self._chosen.decode(data, start, size)
        before = self._embedded.failed
        poses = self._embedded.decode(data, start, size)
        if self._embedded.failed - before < len(start):
            self._chosen = self._embedded
            return poses
        found = self._known.decode(data, start, size)
        rotation = found.value[:, 3:]
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.abs(np.einsum("ij,ij->i", rotation, rotation) - 1)
        if self._known.failed or len(off) == 0 or not (off < UNIT).all():
            self._known.failed = 0
            return poses
        self._chosen = self._known
        self._embedded.failed = before
        return found
