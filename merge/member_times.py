"""Traversal times of the corridors of a fused map, from the maps of its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.topomap import TopoMap
from ..topology.track import by_begin


def member_times(
    maps: Mapping[str, TopoMap],
    edge_members: Sequence[Sequence[tuple[str, int]]],
    *,
    fused_of: Mapping[tuple[str, int], int],
    source: IntArray,
    target: IntArray,
    length: FloatArray,
) -> tuple[IntArray, ...] | None:
    """`TopoMap.traversal_ns` of a fused map; None if some run's map does not have it.

    edge_members: for each fused edge the (run, edge) it was fused from; fused_of[run, vertex]: the
    fused vertex; source, target, length: (m,) of the fused edges. If a run drove past a junction
    undetected, its long corridor is a member of both parts: each part gets the share of the time
    that it has of the length, from the end that the two corridors share (for a part in the middle,
    from the start). O(members).
    """
    if any(m.traversal_ns is None for m in maps.values()):
        return None
    out = []
    for e, members in enumerate(edge_members):
        rows = [np.zeros((0, 2), np.int64)]
        for run, k in members:
            topomap = maps[run]
            if topomap.traversal_ns is None:
                return None
            ends = [fused_of[run, int(v[k])] for v in (topomap.source, topomap.target)]
            share = min(float(length[e] / topomap.length[k]), 1.0)
            if set(ends) == {int(source[e]), int(target[e])}:
                share = 1.0  # the same corridor, measured a little longer
            rows.append(
                _part(topomap.traversal_ns[k], share, ends, (int(source[e]), int(target[e])))
            )
        out.append(by_begin(np.concatenate(rows)))
    return tuple(out)


def _part(
    times_ns: IntArray, share: float, ends: Sequence[int], fused: tuple[int, int]
) -> IntArray:
    """(t, 2) times [ns] at the ends of a fused edge, from those at the ends of a corridor that
    contains it."""
    first, second = times_ns.T
    turned = ends[0] == fused[1] or ends[1] == fused[0]
    at_end = ends[1] in fused and ends[0] not in fused
    most = 2.0**62  # a document can claim any two times
    span = np.round(np.clip((second - first) * share, -most, most)).astype(np.int64)
    near, far = (second, second - span) if at_end else (first, first + span)
    # `near` is at the end of the corridor that the two share; which end of the fused edge is it?
    near_is_source = (not turned) != at_end
    both = (near, far) if near_is_source else (far, near)
    return np.stack(both, axis=1)
