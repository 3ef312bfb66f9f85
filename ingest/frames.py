"""Fixed transforms of a log, e.g. from a sensor to the robot's base."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.wording import listed
from .logs.inflate import unpacked
from .logs.intake import decoder_for, usable_poses
from .logs.messages import UNWANTED, Channel, DamageError
from .logs.poses import PoseDecoder
from .logs.recording import Recording
from .logs.topics import TRANSFORM_KINDS

Pair = tuple[str, str]

NOWHERE_ELSE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""The identity transform."""

FIXED = 1e-3
"""A transform is fixed if no translation [m] or quaternion component changes by more than this, to
allow for rounding."""


@dataclass(frozen=True, slots=True)
class FixedTransforms:
    """Transforms that are constant throughout a log.

    value: by (parent, child) T_parent_child as x, y, z [m], qx, qy, qz, qw; moving: pairs whose
    transform changes; unusable: pairs of which no transform has finite numbers and an orientation.
    """

    value: Mapping[Pair, FloatArray] = field(default_factory=dict)
    moving: frozenset[Pair] = frozenset()
    unusable: frozenset[Pair] = frozenset()

    def connected_to(self, target: str) -> dict[str, FloatArray]:
        """(7,) T_target_source of every frame connected by fixed transforms, along the shortest
        chain.

        O(number of transforms).
        """
        beside: dict[str, list[tuple[str, FloatArray]]] = {}
        for (parent, child), T_parent_child in sorted(self.value.items()):
            beside.setdefault(parent, []).append((child, T_parent_child))
            beside.setdefault(child, []).append((parent, _inverse(T_parent_child)))
        reached = {target: np.array(NOWHERE_ELSE)}
        front = deque([target])
        while front:
            here = front.popleft()
            for there, T_here_there in beside.get(here, ()):
                if there not in reached:
                    reached[there] = seen_from(reached[here], T_here_there[None])[0]
                    front.append(there)
        return reached

    def __str__(self) -> str:
        kinds = (
            ("fixed", self.value),
            ("moving", self.moving),
            ("without usable numbers", self.unusable),
        )
        told = [
            f"{kind}: {listed([f'{a} → {b}' for a, b in sorted(pairs)], 6)}"
            for kind, pairs in kinds
            if pairs
        ]
        return "; ".join(told) or "the log holds no transforms between frames; record /tf_static"


NO_TRANSFORMS = FixedTransforms()


def seen_from(T_a_b: FloatArray, poses: FloatArray) -> FloatArray:
    """Poses (k, 7) of frame b in frame a. T_a_b: (7,)."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(T_a_b[3:])
    turned = turn * Rotation.from_quat(poses[:, 3:])
    return np.hstack([T_a_b[:3] + turn.apply(poses[:, :3]), turned.as_quat()])


def _inverse(T_a_b: FloatArray) -> FloatArray:
    """(7,) T_b_a."""
    from scipy.spatial.transform import Rotation

    back = Rotation.from_quat(T_a_b[3:]).inv()
    return np.concatenate([-back.apply(T_a_b[:3]), back.as_quat()])


def fixed_transforms(recording: Recording) -> FixedTransforms:
    """All transforms between named frames that never change; reads the log once more."""
    decoders: list[tuple[str, PoseDecoder]] = []
    heard = _Heard()

    def want(channel: Channel) -> int:
        if channel.type_name not in TRANSFORM_KINDS:
            return UNWANTED
        try:
            decoders.append((channel.encoding, decoder_for(channel)))
        except DamageError:
            return UNWANTED
        return len(decoders) - 1

    for block in recording.blocks(want):
        encoding, decoder = decoders[block.sink]
        for part, _ in unpacked(block, encoding):
            poses = decoder.decode(part)
            for number in np.unique(poses.frame).tolist():
                heard.compare(decoder.frames.pairs[number], poses.pose[poses.frame == number])
    return heard.found


class _Heard:
    """One value of every pair of frames, and which of them change."""

    def __init__(self) -> None:
        self._known: dict[Pair, FloatArray] = {}
        self._moving: set[Pair] = set()
        self._unusable: set[Pair] = set()

    @property
    def found(self) -> FixedTransforms:
        """What was heard, without what moves, and without frames that have no name."""
        value = {
            pair: first
            for pair, first in sorted(self._known.items())
            if pair not in self._moving and pair[0] != pair[1] and all(pair)
        }
        unusable = self._unusable - self._known.keys()
        return FixedTransforms(value, frozenset(self._moving), frozenset(unusable))

    def compare(self, pair: Pair, value: FloatArray) -> None:
        """Whether (k, 7) transforms are what was heard of the pair before."""
        value = value[usable_poses(value)[1]]
        if len(value) == 0:
            self._unusable.add(pair)
            return
        value[:, 3:] /= np.linalg.norm(value[:, 3:], axis=1)[:, None]
        first = self._known.setdefault(pair, value[0].copy())
        # q and -q are the same rotation.
        value[:, 3:] *= np.where(value[:, 3:] @ first[3:] < 0, -1.0, 1.0)[:, None]
        if (np.abs(value - first) > FIXED).any():
            self._moving.add(pair)
