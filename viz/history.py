"""When each part of a map was first seen, for recordings over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import IntArray
from ..topology.topomap import Closure, TopoMap


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """vertex_ns (n,), corridor_ns (m,): when each was first passed or driven. visit (k,): number of
    each observation among those of its vertex, from 1 on."""

    vertex_ns: IntArray
    corridor_ns: IntArray
    visit: IntArray


def history(topomap: TopoMap) -> History:
    """When vertices and corridors of a map were first seen. O(observations + drives).

    A corridor's time is the end of its first drive or, where drives are not known, when both its
    ends had been seen.
    """
    times, at = topomap.observation_time_ns, topomap.observation_vertex
    last = int(times.max()) if len(times) else 0
    vertex_ns = np.full(len(topomap), np.iinfo(np.int64).max)
    np.minimum.at(vertex_ns, at, times)
    corridor_ns = np.maximum(vertex_ns[topomap.source], vertex_ns[topomap.target])
    for edge, driven in enumerate(topomap.traversal_ns or ()):
        if len(driven):
            corridor_ns[edge] = driven.max(axis=1).min()
    corridor_ns = np.minimum(corridor_ns, last)
    # A junction without an observation of its own is known once a corridor to it is.
    for ends in (topomap.source, topomap.target):
        np.minimum.at(vertex_ns, ends, corridor_ns)
    return History(np.minimum(vertex_ns, last), corridor_ns, _visits(at, len(topomap)))


def _visits(at: IntArray, n: int) -> IntArray:
    seen = np.zeros(n, np.int64)
    out = np.zeros(len(at), np.int64)
    for k, vertex in enumerate(at.tolist()):
        seen[vertex] += 1
        out[k] = seen[vertex]
    return out


@dataclass(frozen=True, slots=True)
class Question:
    """A closure and the rows of its two observations (None: that pass belongs to no vertex), with
    its text."""

    closure: Closure
    rows: tuple[int | None, int | None]
    told: str


def questions(topomap: TopoMap, visit: IntArray) -> list[Question]:
    """Every closure that no later round revised, with its text."""
    row = {t: k for k, t in enumerate(topomap.observation_time_ns.tolist())}
    out = []
    for closure in topomap.closures:
        if not closure.revised:
            rows = (row.get(closure.time_a_ns), row.get(closure.time_b_ns))
            out.append(Question(closure, rows, _told(topomap, visit, closure, rows)))
    return out


def _told(
    topomap: TopoMap, visit: IntArray, closure: Closure, rows: tuple[int | None, int | None]
) -> str:
    names = [
        "a pass that is no junction"
        if k is None
        else f"junction {topomap.observation_vertex[k]} (visit {visit[k]})"
        for k in rows
    ]
    bits = f"{closure.bits:+.1f} bits"
    if closure.accepted and None not in rows:
        a, b = (int(visit[k]) for k in rows if k is not None)
        at = int(topomap.observation_vertex[rows[1] or 0])
        return f"junction {at}: visit {b} recognised as visit {a}, {bits}: {closure.reason}"
    word = "recognised as" if closure.accepted else "not taken for"
    return f"{names[1]} {word} {names[0]}, {bits}: {closure.reason}"
