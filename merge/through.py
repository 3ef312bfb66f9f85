"""Pairs of runs that are only joined through other runs: the chain of accepted pairs between
them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, shortest_path

from ..topology.arrays import IntArray
from .result import PairVerdict


def joined_through(verdicts: Iterable[PairVerdict]) -> dict[tuple[str, str], tuple[str, ...]]:
    """For every pair that is not accepted but connected by accepted ones: the runs between the two
    in the shortest chain, from a to b. O(runs · accepted pairs) per component."""
    pairs = list(verdicts)
    runs = sorted({run for v in pairs for run in (v.a, v.b)})
    row = {run: i for i, run in enumerate(runs)}
    ends = np.array([(row[v.a], row[v.b]) for v in pairs if v.accepted], np.int64).reshape(-1, 2)
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(runs),) * 2)
    label = connected_components(graph, directed=False)[1].tolist()
    candidates: dict[int, list[tuple[int, int]]] = {}
    for v in pairs:
        i, j = row[v.a], row[v.b]
        if not v.accepted and label[i] == label[j]:
            candidates.setdefault(label[i], []).append((i, j))
    members = np.argsort(label, kind="stable")
    first = np.searchsorted(np.array(label)[members], np.arange(len(runs) + 1))
    out = {}
    for own, both in candidates.items():
        nodes = members[first[own] : first[own + 1]]
        for i, j, between in _chains(graph[nodes][:, nodes], np.searchsorted(nodes, both)):
            out[runs[nodes[i]], runs[nodes[j]]] = tuple(runs[nodes[k]] for k in between)
    return out


def _chains(graph: csr_array, pairs: IntArray) -> Iterator[tuple[int, int, list[int]]]:
    """(k, 2) pairs of nodes of a connected graph with the nodes between them."""
    sources, at = np.unique(pairs[:, 0], return_inverse=True)
    _, before = shortest_path(
        graph, "D", directed=False, return_predecessors=True, unweighted=True, indices=sources
    )
    for (i, j), k in zip(pairs.tolist(), at.tolist(), strict=True):
        chain = [int(before[k][j])]
        while chain[-1] != i:
            chain.append(int(before[k][chain[-1]]))
        yield i, j, chain[-2::-1]
