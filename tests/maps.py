"""Maps drawn by hand."""

from __future__ import annotations

import numpy as np

from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, wrap
from topobatch.topology.topomap import TopoMap


def straight_map(
    run, corners, corridors, stubs=(), *, T=(0.0, 0.0, 0.0), sigma=0.05, lengths=None, passes=1
):
    """A map of straight corridors from vertex positions {name: (x, y)} or [(x, y)], corridors
    (name, name) and unexplored branches (name, heading), moved by T. `lengths` overrides what was
    measured; every junction and corridor was passed `passes` times.
    """
    corners = corners if isinstance(corners, dict) else dict(enumerate(corners))
    names = list(corners)
    xy = np.array([corners[n] for n in names], float).reshape(-1, 2)
    rows = [[] for _ in names]
    ends = [(names.index(u), names.index(v)) for u, v in corridors]

    def heading(u, v):
        return float(np.arctan2(*(xy[v] - xy[u])[::-1]))

    for u, v in ends:
        rows[u].append(heading(u, v))
        rows[v].append(heading(v, u))
    for name, direction in stubs:
        rows[names.index(name)].append(direction)
    rows = [np.sort(wrap(np.array(r) + T[2])) for r in rows]

    def branch(u, v):
        return int(np.abs(wrap(rows[u] - heading(u, v) - T[2])).argmin())

    moved = apply(np.array(T), xy)
    length = np.array([np.hypot(*(xy[v] - xy[u])) for u, v in ends])
    for (u, v), value in (lengths or {}).items():
        length[corridors.index((u, v))] = value
    return TopoMap(
        run=run,
        frame="odom",
        xy=moved,
        branches=Ragged.from_rows(rows),
        kind=tuple("dead_end" if len(r) == 1 else "junction" for r in rows),
        source=np.array([u for u, _ in ends], np.int64),
        target=np.array([v for _, v in ends], np.int64),
        source_branch=np.array([branch(u, v) for u, v in ends], np.int64),
        target_branch=np.array([branch(v, u) for u, v in ends], np.int64),
        length=length,
        length_sigma=np.full(len(ends), sigma),
        traversals=np.full(len(ends), passes, np.int64),
        paths=tuple(moved[[u, v]] for u, v in ends),
        observation_vertex=np.repeat(np.arange(len(names)), passes),
        observation_time_ns=np.arange(len(names) * passes) * 10**9,
    )
