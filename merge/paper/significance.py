"""How often chance alone grows a match as large (§3.2).

"Clusters containing only one or two pairs of vertices ... are generally not significant", and how
many are depends on "the size, complexity, and self-similarity of the environment". All three are
estimated from all other matches of the two maps and from those of either map with other parts of
itself.

L: pairs of corridors of two unrelated maps that agree by chance; each starts a match. p:
probability that a further corridor that both maps drove agrees at a pair of vertices so reached. E:
expected number of chance matches as large as one of v vertices; its evidence is -log2 E bits. E is
the largest of these:

- L p^(v - 2): v - 2 further agreements.
- p^(v - m), with m the vertices of the largest match of either map with another part of itself: if
  a building repeats itself, p differs from place to place.
- L p^n q^(v - 2 - n) in rectilinear buildings, where a map slid along a wall still agrees in all
  lengths across it: n is the smaller number of independent lengths along the two axes, and the
  other agreements are of branches alone, with probability q. If degrees may be inexact, pairs of
  vertices that agree have equal branches with probability r, and this bound is multiplied by the
  probability that as many of v - 2 are equal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import take
from ...topology.connected import connected
from ...topology.matching.association import Growth, grow
from ...topology.matching.correspondence import ROTATED, GrowthSettings, masks_agree, node_rotations
from ...topology.matching.structure import Structure


@dataclass(frozen=True, slots=True)
class SelfSimilarity:
    """Statistics of a map's matches with other parts of itself.

    links: pairs of corridors that agree; tested: corridors compared at vertices that a match had
    reached; agreed: how many of these agree; largest: vertices of the largest match, rejected or
    not; ends: how often corridors from compatible vertices end, whatever their lengths, at
    compatible vertices (q); equal: how often these have equal branches (r). ends and equal are 1 if
    the world is not rectilinear.
    """

    links: int
    tested: int
    agreed: int
    largest: int
    ends: float = 1.0
    equal: float = 1.0


def self_similarity(s: Structure, settings: GrowthSettings) -> SelfSimilarity:
    """Statistics of the map matched with itself, without the identity."""
    growth = grow(s, s, settings)
    itself = np.flatnonzero(growth.nodes.vertex_a == growth.nodes.vertex_b)
    turn = node_rotations(s, s, take(growth.nodes, itself), growth.rectilinear)
    other = np.ones(len(growth.rejected), np.bool_)
    # A vertex matched with itself under a rotation is not the identity.
    other[growth.component[itself[np.abs(turn) < 1e-6]]] = False
    vertices = np.bincount(growth.component, minlength=len(other))[other]
    ends, equal = _ends_alike(s, settings) if growth.rectilinear else (1.0, 1.0)
    return SelfSimilarity(
        links=int(np.count_nonzero(other[growth.link_component])),
        tested=int(growth.tested[other].sum() - vertices.sum()),
        agreed=int(growth.agreed[other].sum() - vertices.sum()),
        largest=int(vertices.max(initial=0)),
        ends=ends,
        equal=equal,
    )


def _ends_alike(s: Structure, settings: GrowthSettings) -> tuple[float, float]:
    """Share of the pairs of darts from compatible vertices whose turns and end vertices agree, and
    share of these whose end vertices have equal branches."""
    kind, count = np.unique(s.slot_kind, return_counts=True)
    turn, start, end = kind // 256, kind // 16 % 16, kind % 16
    zero = np.zeros((1, 1), np.int64)
    begins, ends = (masks_agree(m[:, None], m[None], zero, settings) for m in (start, end))
    pairs = count[:, None] * count * begins
    alike = pairs * ends * (turn[:, None] == turn)
    equal = alike * (end[:, None] == end)
    return float(alike.sum() / max(pairs.sum(), 1)), float(equal.sum() / max(alike.sum(), 1))


def match_bits(
    growth: Growth,
    a: Structure,
    b: Structure,
    alike: tuple[SelfSimilarity, SelfSimilarity],
    share: float = 1.0,
) -> FloatArray:
    """(C,) evidence [bits] of every grown match of two maps.

    a, b: the maps; alike: self-similarity of each; share: of all pairs of vertices, those that
    matches were grown from. The chance of a match is estimated from all others, including rejected
    ones. Corridors that close cycles add nothing: their lengths follow from the others. p is the
    mean of its posterior under a uniform prior, which is conservative for few comparisons.
    """
    count = len(growth.rejected)
    vertices = np.bincount(growth.component, minlength=count)
    links = np.bincount(growth.link_component, minlength=count)
    rest = len(growth.link_component) - links
    # One agreement led to each pair of vertices: only the others were open.
    reached = len(growth.nodes) - vertices
    agreed = growth.agreed.sum() - growth.agreed - reached + sum(x.agreed for x in alike)
    tested = growth.tested.sum() - growth.tested - reached + sum(x.tested for x in alike)
    self_information = -np.log2((agreed + 1) / (tested + 2))
    starts = np.maximum(rest, share * max(x.links for x in alike)) + 1
    beyond_chance = (vertices - 2) * self_information - np.log2(starts)
    beyond_copies = (vertices - max(x.largest for x in alike)) * self_information
    bits = np.minimum(beyond_chance, beyond_copies)
    if not growth.rectilinear:
        return np.asarray(bits)
    across = independent_lengths(growth, a).min(axis=0)
    branches_only = np.maximum(vertices - 2 - across, 0)
    of_branches = -np.log2(max(*(x.ends for x in alike), 2.0**-16))
    nodes = growth.nodes
    same = a.mask[nodes.vertex_a] == ROTATED[b.mask[nodes.vertex_b], nodes.correspondence]
    equal = np.bincount(growth.component, same, count)
    # bdtrc(k, n, r) is the probability of more than k.
    chance = bdtrc(equal - 3, vertices - 2, max(x.equal for x in alike))
    of_equal = np.where(equal > 2, -np.log2(np.maximum(chance, 2.0**-64)), 0.0)
    beyond_slides = (
        across * self_information + branches_only * of_branches + of_equal - np.log2(starts)
    )
    return np.asarray(np.minimum(bits, beyond_slides))


def independent_lengths(growth: Growth, a: Structure) -> IntArray:
    """(2, C) number of independent lengths along either axis of matches in a rectilinear world; 0
    for matches of one corridor.

    Vertices joined by perpendicular corridors lie on one line: n + 1 lines have n independent
    distances.
    """
    count = len(growth.rejected)
    several = np.bincount(growth.link_component, minlength=count)[growth.link_component] > 1
    links = growth.links
    codes = np.concatenate([links.start[several], links.end[several]])
    code, node = np.unique(codes, return_inverse=True)
    ends = node.reshape(2, -1)
    match = np.zeros(len(code), np.int64)
    match[ends] = growth.link_component[several]
    axis = a.out_slot[links.dart_a[several]] % 2
    out = np.zeros((2, count), np.int64)
    for k in (0, 1):
        start, end = ends[:, axis != k]
        line = connected(start, end, len(code))
        first = np.unique(line, return_index=True)[1]
        out[k] = np.maximum(np.bincount(match[first], minlength=count) - 1, 0)
    return out


def single_bits(candidates: int) -> float:
    """Evidence [bits] of a match of one pair of vertices: minus log2 of the compatible pairs."""
    return float(-np.log2(max(candidates, 1)))


def cluster_bits(of: IntArray, bits: FloatArray, count: int) -> FloatArray:
    """(count,) evidence [bits] of clusters: the sum over their significant hypotheses, else the
    best one's.

    of, bits: (H,) cluster of each hypothesis (-1: none) and its bits. Conservative: every
    hypothesis of a sum pays for the whole search, although under the cluster's transform there are
    few alternatives.
    """
    kept = of >= 0
    total = np.bincount(of[kept], np.maximum(bits[kept], 0.0), count)
    best = np.full(count, -np.inf)
    np.maximum.at(best, of[kept], bits[kept])
    return np.where(total > 0, total, best)
