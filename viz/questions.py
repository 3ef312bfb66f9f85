"""The closures of a map in words: which visit of a junction was recognised as which."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import IntArray
from ..topology.ragged import numbered
from ..topology.topomap import Closure, TopoMap


@dataclass(frozen=True, slots=True)
class Question:
    """A closure and the rows of its two observations (None: that pass belongs to no vertex), with
    its text."""

    closure: Closure
    rows: tuple[int | None, int | None]
    told: str


def visits(topomap: TopoMap) -> IntArray:
    """(k,) number of each observation among those of its vertex, from 1 on."""
    out = np.zeros(len(topomap.observation_vertex), np.int64)
    out[np.argsort(topomap.observation_vertex, kind="stable")] = numbered(topomap.passes)[1] + 1
    return out


def questions(topomap: TopoMap) -> list[Question]:
    """Every closure that no later round revised, with its text."""
    row = {t: k for k, t in enumerate(topomap.observation_time_ns.tolist())}
    visit = visits(topomap)
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
