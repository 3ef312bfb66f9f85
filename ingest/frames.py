"""Fixed transforms of a log, e.g. from a sensor to the robot's base."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.columns import take
from ..topology.wording import listed
from .logs.inflate import unpacked
from .logs.intake import decoder_for, usable_poses
from .logs.messages import UNWANTED, Channel, DamageError
from .logs.poses import PoseDecoder
from .logs.recording import Recording
from .logs.topics import TRANSFORM_KINDS

Pair = tuple[str, str]

NOWHERE_ELSE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""The identity transform."""
NOWHERE_ELSE.flags.writeable = False

FIXED = 1e-3
"""A transform is fixed if no translation [m] or quaternion component changes by more than this, to
allow for rounding."""


@dataclass(frozen=True, slots=True)
class FixedTransforms:
    """Transforms that are constant throughout a log.

    value: by (parent, child) T_parent_child as x, y, z [m], qx, qy, qz, qw; moving: pairs whose
    transform changes.
    """

    value: Mapping[Pair, FloatArray] = field(default_factory=dict)
    moving: frozenset[Pair] = frozenset()

    def connected_to(self, target: str) -> dict[str, FloatArray]:
        """(7,) T_target_source of every frame connected by fixed transforms, along the shortest
        chain.

        O(number of transforms).
        """
        beside: dict[str, list[tuple[str, FloatArray]]] = {}
        for (parent, child), T_parent_child in sorted(self.value.items()):
            beside.setdefault(parent, []).append((child, T_parent_child))
            beside.setdefault(child, []).append((parent, _inverse(T_parent_child)))
        reached = {target: NOWHERE_ELSE}
        front = deque([target])
        while front:
            here = front.popleft()
            for there, T_here_there in beside.get(here, ()):
                if there not in reached:
                    reached[there] = seen_from(reached[here], T_here_there[None])[0]
                    front.append(there)
        return reached

    def __str__(self) -> str:
        kinds = ("fixed", self.value), ("moving", self.moving)
        lists = [
            f"{kind}: {listed([f'{a} → {b}' for a, b in sorted(pairs)], 6)}"
            for kind, pairs in kinds
            if pairs
        ]
        return "; ".join(lists) or "the log holds no transforms between frames; record /tf_static"


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
    known: dict[Pair, FloatArray] = {}
    moving: set[Pair] = set()

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
            usable = take(poses, usable_poses(poses.pose)[1])
            for number in np.unique(usable.frame).tolist():
                value = usable.pose[usable.frame == number]
                value[:, 3:] /= np.linalg.norm(value[:, 3:], axis=1)[:, None]
                pair = decoder.frames.pairs[number]
                first = known.setdefault(pair, value[0].copy())
                # q and -q are the same rotation.
                value[:, 3:] *= np.where(value[:, 3:] @ first[3:] < 0, -1.0, 1.0)[:, None]
                if (np.abs(value - first) > FIXED).any():
                    moving.add(pair)
    named = {pair for pair in known if pair[0] != pair[1] and all(pair)}
    fixed = {pair: known[pair] for pair in sorted(named - moving)}
    return FixedTransforms(fixed, frozenset(moving))
