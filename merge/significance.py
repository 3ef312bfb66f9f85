"""How often chance alone grows a match as large (§3.2).

"Clusters containing only one or two pairs of vertices ... are generally not significant", and how
many are depends on "the size, complexity, and self-similarity of the environment". All three are
measured on the two maps themselves. Where they share nothing, L pairs of corridors agree by chance,
and each begins a match; at a pair of vertices so reached, a further corridor that both maps drove
agrees with some probability p. A match of v vertices needed v - 2 further agreements, so that
E = L p^(v - 2) of them are to be expected; -log2 E are the bits by which it is more than chance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..topology.association import Growth

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def match_bits(growth: Growth) -> FloatArray:
    """(C,) bits of every grown match. L and p are those of all other matches, rejected ones too.

    Corridors that close circles add nothing: their lengths follow from the others. p is the mean
    of its posterior under a uniform prior, so that few comparisons promise little.
    """
    count = len(growth.rejected)
    vertices = np.bincount(growth.component, minlength=count)
    links = np.bincount(growth.link_component, minlength=count)
    rest = len(growth.link_component) - links
    # One agreement led to each pair of vertices: only the others were open.
    reached = len(growth.nodes) - vertices
    agreed = growth.agreed.sum() - growth.agreed - reached
    tested = growth.tested.sum() - growth.tested - reached
    p = (agreed + 1) / (tested + 2)
    return np.asarray(-(vertices - 2) * np.log2(p) - np.log2(rest + 1))


def single_bits(candidates: int) -> float:
    """Bits of a match of one pair of vertices: any of the compatible pairs would have done."""
    return float(-np.log2(max(candidates, 1)))


def cluster_bits(of: IntArray, bits: FloatArray, count: int) -> FloatArray:
    """(count,) bits of clusters: the sum over their significant hypotheses, else the best one's.

    of, bits: (H,) cluster of each hypothesis (-1: none) and its bits. Every hypothesis of a sum
    pays for the whole search, though under the cluster's transform there were few to choose from.
    """
    kept = of >= 0
    total = np.bincount(of[kept], np.maximum(bits[kept], 0.0), count)
    best = np.full(count, -np.inf)
    np.maximum.at(best, of[kept], bits[kept])
    return np.where(total > 0, total, best)
