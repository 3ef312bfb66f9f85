"""The course of corridors between their ends: sagitta and sample points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.ragged import numbered
from ...topology.topomap import TopoMap
from .settings import MATCH


@dataclass(frozen=True, slots=True, eq=False)
class CorridorPoints:
    """r points along corridors, about `MATCH.clear_m` apart and as far from their ends.

    z: (r,) x + iy [m]; direction: (r,) tangents as unit numbers; edge: (r,) row of the directed
    corridor, from source to target of its edge; tail, head: (r,) vertices that it leads from and
    to; share: (r,) projection on the chord, 0 at the tail … 1 at the head; end_m: (r,) distance
    from the nearer end [m].
    """

    z: ComplexArray
    direction: ComplexArray
    edge: IntArray
    tail: IntArray
    head: IntArray
    share: FloatArray
    end_m: FloatArray

    def __len__(self) -> int:
        return len(self.z)


def corridor_shapes(
    m: TopoMap, rows: IntArray, z: ComplexArray
) -> tuple[FloatArray, CorridorPoints]:
    """Sagitta [m] of every directed corridor, and points along the corridors.

    rows: (c,) edges of the map in use; z: (n,) vertices, x + iy [m]. The 2 c directed corridors are
    these edges from source to target, then from target to source. All polylines are concatenated
    and resampled by one interpolation over the arc length.
    """
    if len(rows) == 0:
        none, rows_, numbers = np.zeros(0, np.complex128), np.zeros(0, np.int64), np.zeros(0)
        return numbers, CorridorPoints(none, none, rows_, rows_, rows_, numbers, numbers)
    tail, head = m.source[rows], m.target[rows]
    paths = [m.paths[r] for r in rows.tolist()]
    size = np.array([len(path) for path in paths])
    flat = np.concatenate(paths)
    line = flat[:, 0] + 1j * flat[:, 1]
    first = np.concatenate([[0], np.cumsum(size)[:-1]])
    step = np.abs(np.diff(line, prepend=line[:1]))
    step[first] = 0.0
    arc = np.cumsum(step)
    start, end = arc[first], arc[first + size - 1]
    # A strictly increasing abscissa for np.interp: consecutive polylines are 1e-6 apart.
    at = arc + np.repeat(np.arange(len(rows)), size) * 1e-6
    shift = np.arange(len(rows)) * 1e-6

    def point(s: FloatArray) -> ComplexArray:
        return np.asarray(np.interp(s, at, line.real) + 1j * np.interp(s, at, line.imag))

    chord = z[head] - z[tail]
    unit = chord / np.abs(chord)
    middle = point((start + end) / 2 + shift)
    bow = ((middle - (z[tail] + z[head]) / 2) * unit.conj()).imag
    inner = np.maximum(end - start - 2 * MATCH.clear_m, 0.0)
    pieces = np.ceil(inner / MATCH.clear_m).astype(np.int64)
    owner, nth = numbered(pieces)
    s = (start + shift)[owner] + MATCH.clear_m + (nth + 0.5) / pieces[owner] * inner[owner]
    tangent = point(s + MATCH.clear_m / 2) - point(s - MATCH.clear_m / 2)
    tangent = tangent / np.maximum(np.abs(tangent), 1e-9)
    at_tail, at_head, where = z[tail[owner]], z[head[owner]], point(s)
    points = CorridorPoints(
        z=where,
        direction=tangent,
        edge=owner,
        tail=tail[owner],
        head=head[owner],
        share=np.clip(((where - at_tail) / chord[owner]).real, 0.0, 1.0),
        end_m=np.minimum(np.abs(where - at_tail), np.abs(where - at_head)),
    )
    return np.concatenate([bow, -bow]), points
