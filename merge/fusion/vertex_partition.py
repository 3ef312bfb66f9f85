"""The partition of the runs' vertices into places: by matched pairs, then by position.

Not all vertices of one place were matched by a pair of maps: a match may be too small to be
accepted, or two runs may be placed through others only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import FloatArray, IntArray
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.ragged import numbered
from ...topology.topomap import TopoMap
from ..result import PairVerdict


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """The vertices of several maps concatenated, with runs sorted by name.

    run: (n,) index of each row's run; vertex: (n,) its vertex; first: row of each run's vertex 0.
    Rows are internal to one fusion; elsewhere a vertex is (run, vertex).
    """

    maps: tuple[TopoMap, ...]
    run: IntArray
    vertex: IntArray
    first: dict[str, int]

    @classmethod
    def of(cls, maps: Sequence[TopoMap]) -> Pool:
        """Pool the maps in their order."""
        sizes = np.array([len(m) for m in maps], np.int64)
        starts = np.cumsum(sizes) - sizes
        run, vertex = numbered(sizes)
        return cls(
            maps=tuple(maps),
            run=run,
            vertex=vertex,
            first={m.run: int(s) for m, s in zip(maps, starts, strict=True)},
        )

    def __len__(self) -> int:
        return len(self.run)


class Groups:
    """Disjoint groups of a pool's rows, with at most one vertex of a run in each."""

    def __init__(self, run: IntArray) -> None:
        self._run = run
        self._head = list(range(len(run)))
        self._rows = [[row] for row in range(len(run))]

    def join(self, row: int, other: int) -> bool:
        """Join the groups of two rows, unless that puts two vertices of a run into one group.
        Returns whether they are in one group."""
        first, second = sorted((self._head[row], self._head[other]))
        if first == second:
            return True
        runs = {int(self._run[r]) for r in self._rows[first]}
        if any(int(self._run[r]) in runs for r in self._rows[second]):
            return False
        for r in self._rows[second]:
            self._head[r] = first
        self._rows[first] += self._rows[second]
        self._rows[second] = []
        return True

    def labels(self) -> IntArray:
        """(n,) group of each row, groups numbered by their first rows."""
        heads = np.array(self._head, np.int64)  # each the first row of its group
        return np.unique(heads, return_inverse=True)[1].astype(np.int64)


def matched_groups(pool: Pool, verdicts: Iterable[PairVerdict]) -> Groups:
    """Groups by the matched pairs of all accepted verdicts, strongest evidence first.

    Matches are transitive. One that would put two vertices of a run into one group is ignored.
    """
    groups = Groups(pool.run)
    for verdict in sorted(verdicts, key=lambda v: (-v.evidence_bits, v.a, v.b)):
        if verdict.best is None:
            continue
        a, b = pool.first[verdict.a], pool.first[verdict.b]
        for u, v in verdict.best.matched.tolist():
            groups.join(a + u, b + v)
    return groups


COINCIDENT_M = 2 * LIKELIHOOD.gate_m
"""Largest distance of two unmatched places that are one. Tried: .9 and 1.5 fuse the same places in
23 merges, .5 one place fewer in two of them. Asked for agreeing branches and corridors, a second
candidate farther off and several coinciding places of two runs, 18 of 3,312 places of 34 merges
stood twice; 2 without, and none held two places either way."""


def coincident(pool: Pool, groups: Groups, pose: FloatArray) -> list[tuple[int, int]]:
    """Pairs of rows whose places are one, nearest first: places that share no run, each of which is
    the other's nearest such place. pose: (n, 3) of every row in the component's frame."""
    label = groups.labels()
    row, size = np.unique(label, return_index=True, return_counts=True)[1:]
    centre = np.stack([np.bincount(label, pose[:, k]) / size for k in (0, 1)], axis=-1)
    if len(size) < 2:
        return []
    runs: list[set[int]] = [set() for _ in size]
    for place, run in zip(label.tolist(), pool.run.tolist(), strict=True):
        runs[place].add(run)
    near = cKDTree(centre).query_pairs(COINCIDENT_M, output_type="ndarray")
    disjoint = np.array([runs[i].isdisjoint(runs[j]) for i, j in near.tolist()], bool)
    u, v = near[disjoint].T
    distance = np.hypot(*(centre[u] - centre[v]).T)
    nearest = np.full(len(size), np.inf)
    for end in (u, v):
        np.minimum.at(nearest, end, distance)
    mutual = np.flatnonzero((distance <= nearest[u]) & (distance <= nearest[v]))
    order = mutual[np.lexsort((v[mutual], u[mutual], distance[mutual]))]
    return list(zip(row[u[order]].tolist(), row[v[order]].tolist(), strict=True))
