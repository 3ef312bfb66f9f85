"""Turning points as vertices of a map, for documents, drawings and route graphs, and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .ragged import Ragged
from .topomap import TopoMap
from .turning_points import KINDS, NO_TURNING_POINTS, TurningPoints


def with_turning_points(topomap: TopoMap) -> TopoMap:
    """The map with its turning points as its last vertices, of one branch each, and the ways to
    them as its last edges. They are as sure as the junctions that they hang on."""
    t = topomap.turning_points
    if len(t) == 0:
        return topomap
    n, k = len(topomap), len(t)
    seen = np.concatenate([topomap.observation_time_ns, *(times[:, 0] for times in t.time_ns)])
    at = np.repeat(np.arange(n, n + k), [len(times) for times in t.time_ns])
    whose = np.concatenate([topomap.observation_vertex, at])
    order = np.lexsort((whose, seen))
    own, times, turn = topomap.position_sigma, topomap.traversal_ns, topomap.branch_sigma
    ends = np.arange(k + 1)
    return replace(
        topomap,
        xy=np.concatenate([topomap.xy, t.xy]),
        branches=Ragged.joined([topomap.branches, Ragged(ends, t.heading)]),
        kind=(*topomap.kind, *t.kind),
        source=np.concatenate([topomap.source, t.vertex]),
        target=np.concatenate([topomap.target, np.arange(n, n + k)]),
        source_branch=np.concatenate([topomap.source_branch, t.branch]),
        target_branch=np.concatenate([topomap.target_branch, np.zeros(k, np.int64)]),
        length=np.concatenate([topomap.length, t.length]),
        length_sigma=np.concatenate([topomap.length_sigma, t.length_sigma]),
        traversals=np.concatenate([topomap.traversals, t.traversals]),
        paths=(*topomap.paths, *t.paths),
        observation_vertex=whose[order],
        observation_time_ns=seen[order],
        position_sigma=None if own is None else np.concatenate([own, t.position_sigma]),
        branch_sigma=None if turn is None else Ragged.joined([turn, Ragged(ends, t.branch_sigma)]),
        traversal_ns=None if times is None else (*times, *t.traversal_ns),
        confidence=np.concatenate([topomap.confidence, topomap.confidence[t.vertex]]),
        turning_points=NO_TURNING_POINTS,
    )


def without_turning_points(topomap: TopoMap) -> TopoMap:
    """The reverse: vertices that are turning points become `turning_points` of the map. Raises
    ValueError where they are not the last ones, or have another way than one from a junction."""
    n = next((k for k, kind in enumerate(topomap.kind) if kind in KINDS), len(topomap))
    k = len(topomap) - n
    if k == 0:
        return topomap
    m = len(topomap.source) - k
    fits = (
        set(topomap.kind[n:]) <= set(KINDS)
        and np.array_equal(topomap.target[m:], np.arange(n, n + k))
        and not np.any(topomap.source[m:] >= n)
        and not np.any(topomap.source[: max(m, 0)] >= n)
        and not np.any(topomap.target[: max(m, 0)] >= n)
        and np.array_equal(topomap.degree[n:], np.ones(k))
    )
    if not fits:
        raise ValueError(
            "turning points come last, each with one branch and one corridor, which leads to it "
            "from a junction, in the order of the turning points"
        )
    late = topomap.observation_vertex >= n
    whose, seen = topomap.observation_vertex, topomap.observation_time_ns
    own, times, turn = topomap.position_sigma, topomap.traversal_ns, topomap.branch_sigma
    none = (np.zeros((0, 2), np.int64),) * k
    points = TurningPoints(
        kind=topomap.kind[n:],
        vertex=topomap.source[m:],
        branch=topomap.source_branch[m:],
        heading=topomap.branches.take(np.arange(n, n + k)).values,
        length=topomap.length[m:],
        length_sigma=topomap.length_sigma[m:],
        position_sigma=topomap.length_sigma[m:] if own is None else own[n:],
        branch_sigma=np.zeros(k) if turn is None else turn.take(np.arange(n, n + k)).values,
        traversals=topomap.traversals[m:],
        paths=topomap.paths[m:],
        traversal_ns=none if times is None else times[m:],
        time_ns=tuple(seen[whose == n + i][:, None] for i in range(k)),
    )
    rows = np.arange(n)
    return replace(
        topomap,
        xy=topomap.xy[:n],
        branches=topomap.branches.take(rows),
        kind=topomap.kind[:n],
        source=topomap.source[:m],
        target=topomap.target[:m],
        source_branch=topomap.source_branch[:m],
        target_branch=topomap.target_branch[:m],
        length=topomap.length[:m],
        length_sigma=topomap.length_sigma[:m],
        traversals=topomap.traversals[:m],
        paths=topomap.paths[:m],
        observation_vertex=whose[~late],
        observation_time_ns=seen[~late],
        position_sigma=None if own is None else own[:n],
        branch_sigma=None if turn is None else turn.take(rows),
        traversal_ns=None if times is None else times[:m],
        confidence=topomap.confidence[:n],
        turning_points=points,
    )
