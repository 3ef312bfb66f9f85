"""Poses as they come out of messages, whatever the message's type and encoding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import FloatArray, IntArray
from .messages import Bytes, DamageError

Row = tuple[int, int, list[tuple[float, ...]]]
"""Stamp [ns], number of the frames and poses of one junction, decoded one by one."""

FRAMES = 1024
"""Largest number of pairs of frames in one topic."""


class Poses(NamedTuple):
    """Poses of a batch of messages, in the order of the messages.

    message: (k,) index of the message in the batch; part: (k,) index of the junction in the
    message, if it has several; stamp_ns: (k,) header time; frame: (k,) number in the decoder's
    frames; value: (k, 7) x, y, z [m], qx, qy, qz, qw, as recorded; sigma_m: (k,) 1 sigma of the
    positions [m] as stated, NaN where not; None if the type of message states none.
    """

    message: IntArray
    part: IntArray
    stamp_ns: IntArray
    frame: IntArray
    value: FloatArray
    sigma_m: FloatArray | None = None

    def rows(self, which: NDArray[Any]) -> Poses:
        """The chosen poses, by number or by mask."""
        return Poses(
            self.message[which],
            self.part[which],
            self.stamp_ns[which],
            self.frame[which],
            self.value[which],
            None if self.sigma_m is None else self.sigma_m[which],
        )


@dataclass(slots=True)
class Frames:
    """Pairs (frame_id, child_frame_id) of a topic, numbered; a leading slash is dropped."""

    pairs: list[tuple[str, str]] = field(default_factory=list)
    _number: dict[tuple[str, str], int] = field(default_factory=dict)

    def number(self, frame: str, child: str = "") -> int:
        """The number of a pair; raises DamageError when there are implausibly many."""
        pair = (frame.lstrip("/"), child.lstrip("/"))
        known = self._number.get(pair)
        if known is None:
            if len(self.pairs) >= FRAMES:
                raise DamageError("implausibly many frame names")
            known = self._number[pair] = len(self.pairs)
            self.pairs.append(pair)
        return known


class PoseDecoder(Protocol):
    """Decodes payloads to poses; what cannot be decoded is left out and counted in `failed`."""

    @property
    def frames(self) -> Frames:
        """Numbers of the frames met."""

    @property
    def failed(self) -> int:
        """Messages that could not be decoded."""

    @property
    def reason(self) -> str:
        """Why the first of them could not be."""

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> Poses:
        """The poses of the messages at `start` with `size` in `data`."""


def no_poses() -> Poses:
    """A batch without poses."""
    none = np.zeros(0, np.int64)
    return Poses(none, none, none, none, np.zeros((0, 7)))


def join(parts: Sequence[Poses]) -> Poses:
    """Batches over the same messages as one, in the order of the messages."""
    if not parts:
        return no_poses()
    if len(parts) == 1:
        return parts[0]
    *columns, sigmas = zip(*parts, strict=True)
    sigma_m = None if any(s is None for s in sigmas) else np.concatenate(sigmas)
    message, part, stamp_ns, frame, value = map(np.concatenate, columns)
    joined = Poses(message, part, stamp_ns, frame, value, sigma_m)
    return joined.rows(np.argsort(joined.message, kind="stable"))
