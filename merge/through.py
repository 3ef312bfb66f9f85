"""Pairs of runs that are only joined through other runs: the chain of accepted pairs between
them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, shortest_path

from .result import PairVerdict


def joined_through(verdicts: Iterable[PairVerdict]) -> dict[tuple[str, str], tuple[str, ...]]:
    """For every pair that is not accepted but connected by accepted ones: the runs between the two
    in the shortest chain, from a to b. O(runs · accepted pairs)."""
    pairs = list(verdicts)
    runs = sorted({run for v in pairs for run in (v.a, v.b)})
    row = {run: i for i, run in enumerate(runs)}
    ends = np.array([(row[v.a], row[v.b]) for v in pairs if v.accepted], np.int64).reshape(-1, 2)
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(runs),) * 2)
    label = connected_components(graph, directed=False)[1].tolist()
    wanted: dict[int, list[int]] = {}
    for v in pairs:
        i, j = row[v.a], row[v.b]
        if not v.accepted and label[i] == label[j]:
            wanted.setdefault(i, []).append(j)
    out = {}
    for i, others in wanted.items():
        _, before = shortest_path(
            graph, "D", directed=False, return_predecessors=True, unweighted=True, indices=i
        )
        for j in others:
            chain = [int(before[j])]
            while chain[-1] != i:
                chain.append(int(before[chain[-1]]))
            out[runs[i], runs[j]] = tuple(runs[k] for k in chain[-2::-1])
    return out
