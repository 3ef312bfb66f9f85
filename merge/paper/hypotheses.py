"""The paper's hypotheses: every valid grown match, and those of a single vertex, with their
transforms (§2, §3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined, take
from ...topology.matching.association import Growth, SingleMatches, grow, single_matches
from ...topology.matching.correspondence import (
    GrowthSettings,
    Nodes,
    candidate_nodes,
    is_rectilinear,
    node_rotations,
    shared_branches,
)
from ...topology.matching.structure import Structure
from ...topology.se2 import apply
from .registration import Weights, fit_groups
from .significance import SelfSimilarity, match_bits, single_bits


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """H valid hypotheses, the largest first, then by their first pair.

    of: (N,) hypothesis of each vertex pair, ascending; nodes: the N pairs with the correspondence
    of their branches. size: (H,) vertex pairs; corridors: (H,) corridor pairs; transform: (H, 3)
    T_a_b; error: (H,) mean squared distance of the matched vertices [m²]; bits: (H,) evidence
    against chance (`significance`).
    """

    of: IntArray
    nodes: Nodes
    size: IntArray
    corridors: IntArray
    transform: FloatArray
    error: FloatArray
    bits: FloatArray
    rectilinear: bool

    def __len__(self) -> int:
        return len(self.size)

    @property
    def vertex_a(self) -> IntArray:
        """(N,) vertices of a."""
        return self.nodes.vertex_a

    @property
    def vertex_b(self) -> IntArray:
        """(N,) vertices of b."""
        return self.nodes.vertex_b


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Hypotheses before their transforms: pairs with the match of each; corridors and bits."""

    of: IntArray
    nodes: Nodes
    corridors: IntArray
    bits: FloatArray


def hypothesise(
    a: Structure,
    b: Structure,
    xy: tuple[FloatArray, FloatArray],
    settings: GrowthSettings,
    *,
    near: tuple[IntArray, IntArray] | None,
    alike: tuple[SelfSimilarity, SelfSimilarity],
    weights: Weights,
) -> Hypotheses:
    """All valid hypotheses of two maps and their transforms.

    Including pairs of vertices that no corridor tests (§2.3: "cannot be grown further"). xy:
    embedded vertices of a and of b (§3.1) [m]. near: vertices of a and of b from which alone
    matches are grown (§4.2). alike: self-similarity of each map. weights: of the vertices in
    registration.
    """
    grown, singles = _grown(a, b, settings, near)
    share = 1.0 if near is None else len(near[0]) * len(near[1]) / (len(a) * len(b))
    matches = _ordered(_valid(grown, match_bits(grown, a, b, alike, share), singles))
    of, nodes = matches.of, matches.nodes
    rectilinear = is_rectilinear(a, b, settings)
    rotation = node_rotations(a, b, nodes, rectilinear)
    p, q = xy[0][nodes.vertex_a], xy[1][nodes.vertex_b]
    size = np.bincount(of, minlength=len(matches.corridors))
    transform = _transforms(p, q, of, rotation, weights, rectilinear=rectilinear)
    squared = np.bincount(of, ((p - apply(transform[of], q)) ** 2).sum(axis=1), len(size))
    return Hypotheses(
        of=of,
        nodes=nodes,
        size=size,
        corridors=matches.corridors,
        transform=transform,
        error=squared / np.maximum(size, 1),
        bits=matches.bits,
        rectilinear=rectilinear,
    )


def _grown(
    a: Structure, b: Structure, settings: GrowthSettings, near: tuple[IntArray, IntArray] | None
) -> tuple[Growth, SingleMatches]:
    """The matches with corridors, and those without; near: from pairs of these vertices only."""
    if near is None:
        growth = grow(a, b, settings)
        return growth, single_matches(a, b, growth, settings)
    seeds = candidate_nodes(a, b, settings, near)
    growth = grow(a, b, settings, seeds)
    untested = shared_branches(a, b, seeds, growth.rectilinear) == 0
    return growth, SingleMatches(take(seeds, untested), len(seeds))


def _valid(growth: Growth, bits: FloatArray, singles: SingleMatches) -> _Matches:
    """The matches that were not rejected, then those of a single vertex."""
    valid = ~growth.rejected
    number, count = np.cumsum(valid) - 1, int(np.count_nonzero(valid))
    rows, links = valid[growth.component], valid[growth.link_component]
    lone = count + np.arange(len(singles.nodes))
    of_links = number[growth.link_component[links]]
    return _Matches(
        of=np.concatenate([number[growth.component[rows]], lone]),
        nodes=joined([take(growth.nodes, rows), singles.nodes]),
        corridors=np.bincount(of_links, minlength=count + len(lone)).astype(np.int64),
        bits=np.concatenate([bits[valid], np.full(len(lone), single_bits(singles.candidates))]),
    )


def _ordered(matches: _Matches) -> _Matches:
    """Hypotheses renumbered: the largest first, then by their first pair; pairs in order."""
    of, nodes, count = matches.of, matches.nodes, len(matches.corridors)
    if count == 0:
        return matches
    keys = (nodes.correspondence, nodes.vertex_b, nodes.vertex_a)
    size = np.bincount(of, minlength=count)
    first = np.lexsort((*keys, of))[np.concatenate([[0], np.cumsum(size)[:-1]])]
    order = np.lexsort((*(k[first] for k in keys), -size))
    rank = np.argsort(order)
    rows = np.lexsort((*keys, rank[of]))
    chosen = (matches.corridors[order], matches.bits[order])
    return _Matches(rank[of][rows], take(nodes, rows), *chosen)


def _transforms(
    p: FloatArray,
    q: FloatArray,
    of: IntArray,
    rotation: FloatArray,
    weights: Weights,
    *,
    rectilinear: bool,
) -> FloatArray:
    """(H, 3) T_a_b of every hypothesis; the rotation is that of the branches where points do not
    determine it."""
    count = int(of.max(initial=-1)) + 1
    cos, sin = (np.bincount(of, f(rotation), count) for f in (np.cos, np.sin))
    several = np.bincount(of, minlength=count) > 1
    free = several & (not rectilinear)
    return fit_groups(p, q, of, np.arctan2(sin, cos), free=free, weights=weights)
