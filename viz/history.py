"""When a robot came to know its map: what a recording lights up as time goes on."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..topology.topomap import Closure, TopoMap

IntArray = NDArray[np.int64]

LONGEST_DETOUR = 3
"""Corridors between two passes at most: more junctions are hardly missed one after the other."""


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """vertex_ns: (n,) and corridor_ns: (m,) when each was first passed or driven; visit: (k,)
    number of each observation among those of its vertex, from 1 on."""

    vertex_ns: IntArray
    corridor_ns: IntArray
    visit: IntArray


def history(topomap: TopoMap) -> History:
    """When vertices and corridors of a map were first met. O(observations + edges).

    A corridor counts from the second of two passes in a row between which it lies. Of several
    between the same two vertices the first that was not driven yet is taken, so that these may be
    swapped. What no two passes explain counts from when both its ends are known.
    """
    times, at = topomap.observation_time_ns, topomap.observation_vertex
    last = int(times.max()) if len(times) else 0
    vertex_ns = np.full(len(topomap), np.iinfo(np.int64).max)
    np.minimum.at(vertex_ns, at, times)
    driven: dict[int, int] = {}
    around = _around(topomap)
    for u, v, time_ns in zip(at[:-1].tolist(), at[1:].tolist(), times[1:].tolist(), strict=True):
        for edge in _between(around, u, v, driven):
            driven.setdefault(edge, time_ns)
    corridor_ns = np.maximum(vertex_ns[topomap.source], vertex_ns[topomap.target])
    for edge, time_ns in driven.items():
        corridor_ns[edge] = time_ns
    corridor_ns = np.minimum(corridor_ns, last)
    # Junctions that were driven by unseen are known as soon as a corridor leads there.
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


Around = dict[int, list[tuple[int, int]]]


def _around(topomap: TopoMap) -> Around:
    """For each vertex its (edge, other end), in the order of the edges."""
    around: Around = {}
    ends = zip(topomap.source.tolist(), topomap.target.tolist(), strict=True)
    for edge, (u, v) in enumerate(ends):
        around.setdefault(u, []).append((edge, v))
        if u != v:
            around.setdefault(v, []).append((edge, u))
    return around


def _between(around: Around, u: int, v: int, driven: dict[int, int]) -> list[int]:
    """The edges driven between passes of u and v: one, or the shortest chain of a few."""
    direct = [edge for edge, other in around.get(u, []) if other == v]
    if direct:
        return [next((edge for edge in direct if edge not in driven), direct[0])]
    before: dict[int, tuple[int, int]] = {u: (-1, u)}
    queue = deque([(u, 0)])
    while queue and v not in before:
        vertex, hops = queue.popleft()
        if hops == LONGEST_DETOUR:
            continue
        for edge, other in around.get(vertex, []):
            if other not in before:
                before[other] = (edge, vertex)
                queue.append((other, hops + 1))
    chain: list[int] = []
    while v in before and v != u:
        edge, v = before[v]
        chain.append(edge)
    return chain


@dataclass(frozen=True, slots=True)
class Question:
    """A closure by the numbers of its junctions: rows of the two observations, or None where a pass
    ended in no junction."""

    closure: Closure
    rows: tuple[int | None, int | None]
    told: str


def questions(topomap: TopoMap, visit: IntArray) -> list[Question]:
    """Every closure that was not replaced by a later round, in words that name junctions."""
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
