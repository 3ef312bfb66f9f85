"""Runs that only others join: by which chain of accepted pairs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from .result import PairVerdict


def joined_through(verdicts: Iterable[PairVerdict]) -> dict[tuple[str, str], tuple[str, ...]]:
    """For every pair that is not accepted but connected by accepted ones: the runs between the two
    in the shortest chain, from a to b. O(runs · accepted pairs)."""
    pairs = list(verdicts)
    runs = sorted({run for v in pairs for run in (v.a, v.b)})
    row = {run: i for i, run in enumerate(runs)}
    ends = np.array([(row[v.a], row[v.b]) for v in pairs if v.accepted], np.int64).reshape(-1, 2)
    if len(ends) < 2:
        return {}
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(runs),) * 2)
    steps, before = shortest_path(graph, directed=False, unweighted=True, return_predecessors=True)
    out = {}
    for v in pairs:
        i, j = row[v.a], row[v.b]
        if not v.accepted and np.isfinite(steps[i, j]):
            out[v.a, v.b] = tuple(runs[k] for k in _between(before[i], i, j))
    return out


def _between(before: np.ndarray, start: int, end: int) -> list[int]:
    """The nodes between two, by the predecessors on the ways from the first."""
    chain = []
    at = int(before[end])
    while at != start:
        chain.append(at)
        at = int(before[at])
    return chain[::-1]
