"""Pairs of vertices under a correspondence of their branches (§2.1, §2.3).

In a rectilinear world orientations are known up to quarter turns, and a vertex is a set of slots.
On general angles branches are compared with a tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1, log
from statistics import NormalDist
from typing import Literal

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import take
from ..errors import UsageError
from ..passes import ONE_WAY_RAD
from ..ragged import numbered
from ..se2 import wrap
from .branches import mutual_nearest
from .structure import Structure

World = Literal["auto", "rectilinear", "general"]


QUARTER = np.pi / 2


POPCOUNT = np.array([bin(m).count("1") for m in range(16)], np.int64)


ROTATED = np.array([[((m << r) | (m >> (4 - r))) & 15 for r in range(4)] for m in range(16)])
"""ROTATED[mask, r]: the slots of `mask` rotated by r quarter turns."""


@dataclass(frozen=True, slots=True)
class GrowthSettings:
    """When vertices and corridors are compatible (§2.1, §2.2, §2.3)."""

    world: World = "auto"
    """rectilinear: branch directions are exact up to quarter turns (§2.3); general: corresponding
    ones lie within `ONE_WAY_RAD` after the pair's rotation; auto: rectilinear if both maps are."""
    degree: Literal["exact", "inexact"] = "exact"
    """exact: a static world; inexact: doors open and close, so that one branch of either vertex of
    a pair may lack a partner (§2.1)."""
    confidence: float = 0.999
    """Probability that a correct match passes the comparison of its lengths."""
    confidence_of: Literal["match", "corridor"] = "match"
    """match: the confidence holds for all corridors of a match together; corridor: for each
    corridor by itself, as published (§5: 95 %), so that a correct match of k corridors passes with
    confidence ** k."""

    def __post_init__(self) -> None:
        if not 0.0 < self.confidence < 1.0:
            raise UsageError(f"a confidence lies between 0 and 1, not at {self.confidence}")

    def bound_sigmas(self, corridors: int) -> float:
        """Largest accepted difference of two lengths, in standard deviations, in a match of so many
        corridors.

        k normal differences, correlated or not, all lie within z standard deviations with a
        probability of at least (2 Φ(z) - 1) ** k (Šidák 1967); z is chosen so that this is
        `confidence`.
        """
        count = corridors if self.confidence_of == "match" else 1
        outside = -expm1(log(self.confidence) / max(count, 1))
        return -NormalDist().inv_cdf(outside / 2)


DEFAULT_GROWTH = GrowthSettings()


Ends = tuple[IntArray, IntArray]
"""Vertices (k,) and, at each, the branch by which a dart leaves or arrives (k,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Vertices of a paired with vertices of b under a correspondence of their branches.

    vertex_a, vertex_b: (N,); correspondence: (N,) quarter turns of b (rectilinear worlds) or the
    partners of a's branches as one number (general worlds, see `partners`).
    """

    vertex_a: IntArray
    vertex_b: IntArray
    correspondence: IntArray

    def __len__(self) -> int:
        return len(self.vertex_a)


def is_rectilinear(a: Structure, b: Structure, settings: GrowthSettings) -> bool:
    """Whether a and b are matched with orientations exact up to quarter turns (§2.3)."""
    return settings.world != "general" and a.grid_rad is not None and b.grid_rad is not None


def correspond(
    a: Structure, b: Structure, at_a: Ends, at_b: Ends, settings: GrowthSettings = DEFAULT_GROWTH
) -> tuple[BoolArray, IntArray]:
    """Correspondences of the branches of k vertex pairs that contain a given pair of branches
    (§2.1).

    Returns ok (k,), whether the vertices are compatible under it, and partner (k, D_a), for each
    branch of a its partner in b, -1 for none. Correspondences keep the cyclic order of branches:
    maps are not mirrored.
    """
    if settings.degree == "exact":
        return _correspond_exact(a, b, at_a, at_b)
    return _correspond_inexact(a, b, at_a, at_b)


def _correspond_exact(
    a: Structure, b: Structure, at_a: Ends, at_b: Ends
) -> tuple[BoolArray, IntArray]:
    """`correspond` for equal degrees: branch i of a with branch i + shift of b, all within the
    tolerance."""
    (vertex_a, branch_a), (vertex_b, branch_b) = at_a, at_b
    degree, shift = a.degree[vertex_a], branch_b - branch_a
    equal = degree == b.degree[vertex_b]
    columns = np.arange(a.heading.shape[1])
    inside = (columns < degree[:, None]) & equal[:, None]
    partner = np.where(inside, (columns + shift[:, None]) % np.maximum(degree, 1)[:, None], -1)
    hb = b.heading[vertex_b[:, None], np.maximum(partner, 0)]
    anchor = a.heading[vertex_a, branch_a] - b.heading[vertex_b, branch_b]
    difference = np.where(inside, wrap(a.heading[vertex_a] - hb - anchor[:, None]), 0.0)
    mean = difference.sum(axis=1) / np.maximum(degree, 1)
    deviation = np.where(inside, np.abs(difference - mean[:, None]), 0.0)
    return equal & (deviation.max(axis=1, initial=0.0) <= ONE_WAY_RAD), partner


def _correspond_inexact(
    a: Structure, b: Structure, at_a: Ends, at_b: Ends
) -> tuple[BoolArray, IntArray]:
    """`correspond` for inexact degrees: one branch of a vertex may have no partner."""
    # Strategy: the given pair fixes a rotation, and mutually nearest branches within the tolerance
    # correspond. Their mean difference is the rotation of a second pass.
    (vertex_a, branch_a), (vertex_b, branch_b) = at_a, at_b
    ua, ub = a.unit[vertex_a], b.unit[vertex_b]
    rows, gate = np.arange(len(vertex_a)), float(np.cos(ONE_WAY_RAD))
    rotation = ua[rows, branch_a] * ub[rows, branch_b].conj()
    for _ in range(2):
        pairs = mutual_nearest(ua, ub * rotation[:, None], gate)
        difference = ua * np.take_along_axis(ub, pairs.nearest, axis=1).conj()
        total = np.where(pairs.paired, difference, 0.0).sum(axis=1)
        rotation = np.exp(1j * np.angle(total))
    partner, count = np.where(pairs.paired, pairs.nearest, -1), pairs.paired.sum(axis=1)
    compatible = (a.degree[vertex_a] - count <= 1) & (b.degree[vertex_b] - count <= 1)
    return compatible & (partner[rows, branch_a] == branch_b), partner


def masks_agree(
    mask_a: IntArray, mask_b: IntArray, turn: IntArray, settings: GrowthSettings
) -> BoolArray:
    """Whether slot sets agree after turning b's by quarter turns: equal, or for inexact degrees
    nearly so."""
    turned = ROTATED[mask_b, turn]
    if settings.degree == "exact":
        return np.asarray(turned == mask_a)
    unpaired_a, unpaired_b = POPCOUNT[mask_a & ~turned], POPCOUNT[turned & ~mask_a]
    return np.asarray((unpaired_a <= 1) & (unpaired_b <= 1) & ((mask_a & turned) != 0))


def shared_branches(a: Structure, b: Structure, nodes: Nodes, rectilinear: bool) -> IntArray:
    """(N,) number of corresponding branches that were driven in both maps."""
    if rectilinear:
        turned = ROTATED[b.explored_mask[nodes.vertex_b], nodes.correspondence]
        return np.asarray(POPCOUNT[a.explored_mask[nodes.vertex_a] & turned])
    partner = partners(a, b, nodes.correspondence)
    driven = b.explored[nodes.vertex_b[:, None], np.maximum(partner, 0)] & (partner >= 0)
    return np.asarray((a.explored[nodes.vertex_a] & driven).sum(axis=1))


def node_rotations(a: Structure, b: Structure, nodes: Nodes, rectilinear: bool) -> FloatArray:
    """(N,) angle [rad] that takes b's directions to a's at each node."""
    if rectilinear:
        grid = (a.grid_rad or 0.0) - (b.grid_rad or 0.0)
        return np.asarray(wrap(grid + QUARTER * nodes.correspondence))
    partner = partners(a, b, nodes.correspondence)
    partner_unit = b.unit[nodes.vertex_b[:, None], np.maximum(partner, 0)]
    rotations = np.where(partner >= 0, a.unit[nodes.vertex_a] * partner_unit.conj(), 0.0)
    return np.asarray(np.angle(rotations.sum(axis=1)))


def encode(
    a: Structure, b: Structure, vertex_a: IntArray, vertex_b: IntArray, partner: IntArray
) -> IntArray:
    """(k,) one integer per (vertex of a, vertex of b, correspondence). Raises ValueError where it
    would overflow."""
    base, size = b.heading.shape[1] + 1, _correspondences(a, b)
    if float(len(a)) * len(b) * size > 2.0**62:
        raise ValueError("junctions with this many branches cannot be matched")
    digits = np.array([base**k for k in range(a.heading.shape[1])], np.int64)
    return (vertex_a * len(b) + vertex_b) * size + (partner + 1) @ digits


def _correspondences(a: Structure, b: Structure) -> int:
    return int((b.heading.shape[1] + 1) ** a.heading.shape[1])


def decode(a: Structure, b: Structure, code: IntArray, rectilinear: bool) -> Nodes:
    """The nodes of codes (N,); inverse of `encode` and `node_codes`."""
    size = 4 if rectilinear else _correspondences(a, b)
    pair, correspondence = np.divmod(code, size)
    return Nodes(pair // len(b), pair % len(b), correspondence)


def partners(a: Structure, b: Structure, correspondence: IntArray) -> IntArray:
    """(k, D_a) partner in b of each branch of a, -1 for none, from encoded correspondences (k,)."""
    base = b.heading.shape[1] + 1
    digits = np.array([base**k for k in range(a.heading.shape[1])], np.int64)
    return np.asarray(correspondence[:, None] // digits % base - 1)


def node_codes(a: Structure, b: Structure, nodes: Nodes, rectilinear: bool) -> IntArray:
    """(N,) codes of nodes; inverse of `decode`."""
    size = 4 if rectilinear else _correspondences(a, b)
    return (nodes.vertex_a * len(b) + nodes.vertex_b) * size + nodes.correspondence


def candidate_nodes(
    a: Structure,
    b: Structure,
    settings: GrowthSettings = DEFAULT_GROWTH,
    near: tuple[IntArray, IntArray] | None = None,
) -> Nodes:
    """All compatible pairs of vertices under all their correspondences (§2.1), ascending.

    near: the vertices of a and of b to pair, ascending; all by default.
    """
    if not is_rectilinear(a, b, settings):
        return decode(a, b, _angle_candidates(a, b, settings, near), False)
    classes = SlotClasses.of(a, b, settings, near)
    return classes.expanded(classes.compatible)


@dataclass(frozen=True, slots=True, eq=False)
class SlotClasses:
    """Vertices of both maps, in classes of equal (branch slots, driven slots).

    compatible: (C_a, C_b, 4) whether vertices of two classes pair under a quarter turn; disjoint:
    (C_a, C_b, 4) whether they share no driven branch; rows: vertices of a and of b, sorted by
    class; first: (C + 1,) start of each class in them.
    """

    compatible: BoolArray
    disjoint: BoolArray
    rows: tuple[IntArray, IntArray]
    first: tuple[IntArray, IntArray]

    @classmethod
    def of(
        cls,
        a: Structure,
        b: Structure,
        settings: GrowthSettings,
        near: tuple[IntArray, IntArray] | None = None,
    ) -> SlotClasses:
        """The classes of two rectilinear maps; near: of these vertices of a and of b only."""
        kinds, rows, first = [], [], []
        for s, chosen in zip((a, b), near or (np.arange(len(a)), np.arange(len(b))), strict=True):
            kind = s.mask[chosen] * 16 + s.explored_mask[chosen]
            order = np.argsort(kind, kind="stable")
            distinct, start = np.unique(kind[order], return_index=True)
            kinds.append(distinct)
            rows.append(chosen[order])
            first.append(np.append(start, len(order)))
        turns = np.arange(4)
        mask_a, driven_a = (k[:, None, None] for k in np.divmod(kinds[0], 16))
        mask_b, driven_b = (k[None, :, None] for k in np.divmod(kinds[1], 16))
        return cls(
            compatible=masks_agree(mask_a, mask_b, turns, settings) & (mask_a > 0),
            disjoint=np.asarray((driven_a & ROTATED[driven_b, turns]) == 0),
            rows=(rows[0], rows[1]),
            first=(first[0], first[1]),
        )

    @property
    def sizes(self) -> IntArray:
        """(C_a, C_b) number of vertex pairs of each pair of classes."""
        return np.asarray(np.diff(self.first[0])[:, None] * np.diff(self.first[1]))

    def expanded(self, chosen: BoolArray) -> Nodes:
        """The nodes of the chosen (C_a, C_b, 4) classes and turns, ascending."""
        # Strategy: a flat ragged product; node k of a triple is (k // width, k % width) of it.
        i, j, turn = np.nonzero(chosen)
        count, width = self.sizes[i, j], np.diff(self.first[1])[j]
        triple, within = numbered(count)
        x, y = np.divmod(within, width[triple])
        vertex_a = self.rows[0][self.first[0][i][triple] + x]
        vertex_b = self.rows[1][self.first[1][j][triple] + y]
        nodes = Nodes(vertex_a, vertex_b, turn[triple])
        return take(nodes, np.lexsort((nodes.correspondence, vertex_b, vertex_a)))


def _angle_candidates(
    a: Structure, b: Structure, settings: GrowthSettings, near: tuple[IntArray, IntArray] | None
) -> IntArray:
    """Codes of all compatible nodes on general angles, ascending; chunked over vertices of a."""
    rows, columns = near or (np.arange(len(a)), np.arange(len(b)))
    chunk = max(1, 200_000 // max(1, len(columns) * b.heading.shape[1] * a.heading.shape[1]))
    codes = [
        _angle_candidates_of(a, b, (rows[low : low + chunk], columns), settings)
        for low in range(0, len(rows), chunk)
    ]
    return np.unique(np.concatenate(codes)) if codes else np.zeros(0, np.int64)


def _angle_candidates_of(
    a: Structure, b: Structure, vertices: tuple[IntArray, IntArray], settings: GrowthSettings
) -> IntArray:
    # Every branch of b may go with the first of a; with inexact degrees the first may be missing.
    first = a.heading.shape[1] if settings.degree == "inexact" else min(a.heading.shape[1], 1)
    u, i, v, j = (
        x.reshape(-1)
        for x in np.meshgrid(
            vertices[0], np.arange(first), vertices[1], np.arange(b.heading.shape[1]), indexing="ij"
        )
    )
    exists = (i < a.degree[u]) & (j < b.degree[v])
    if settings.degree == "exact":
        exists &= a.degree[u] == b.degree[v]
    u, i, v, j = u[exists], i[exists], v[exists], j[exists]
    compatible, partner = correspond(a, b, (u, i), (v, j), settings)
    return encode(a, b, u[compatible], v[compatible], partner[compatible])
