"""Prepared maps concatenated, so that many pairs of maps are matched by one call.

The arrays of one map have about fifty rows, so that the overhead of numpy calls dominates:
concatenated, pairs are matched in half the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.columns import joined
from ...topology.ragged import numbered
from .prepare import CorridorsByEnds, Prepared

OF_VERTICES = ("z", "count", "observations", "fault_rate", "descriptor", "confidence")
OF_CORRIDORS = (
    *("length", "sagitta", "variance", "traversals", "rarity", "angle", "end_information"),
)
"""Arrays of `Prepared` without row numbers: those of vertices, and of directed corridors."""


@dataclass(frozen=True, eq=False)
class Atlas:
    """m maps with their vertices, directed corridors and points of corridors numbered
    consecutively.

    whole: the concatenated arrays; its scalar fields are those of the first map. vertex, corridor,
    point: (m + 1,) first row of each map.
    """

    maps: tuple[Prepared, ...]
    whole: Prepared
    vertex: IntArray
    corridor: IntArray
    point: IntArray

    @classmethod
    def of(cls, maps: Sequence[Prepared]) -> Atlas:
        """Concatenate maps. O(rows)."""
        sizes = np.array([(0, 0, 0), *((len(m.z), len(m.tail), len(m.points)) for m in maps)])
        vertex, corridor, point = sizes.cumsum(axis=0).T
        return cls(
            maps=tuple(maps),
            whole=maps[0] if len(maps) == 1 else _whole(maps, vertex, corridor),
            vertex=vertex,
            corridor=corridor,
            point=point,
        )

    @classmethod
    def of_pairs(cls, pairs: Sequence[tuple[Prepared, Prepared]]) -> tuple[Atlas, IntArray]:
        """The distinct maps of some pairs, and the rows (k, 2) of each pair's maps."""
        number: dict[int, int] = {}
        rows = [[number.setdefault(id(m), len(number)) for m in pair] for pair in pairs]
        maps = {id(m): m for pair in pairs for m in pair}
        return cls.of([maps[key] for key in number]), np.array(rows)

    @cached_property
    def shows_bends(self) -> BoolArray:
        """(m,) as in `TopoMap`."""
        return np.array([m.topomap.shows_bends for m in self.maps], np.bool_)

    @cached_property
    def centre_m(self) -> FloatArray:
        """(m,) `RunNoise.centre_m` of each map [m]."""
        return np.array([m.noise.centre_m for m in self.maps])

    @cached_property
    def miss_rate(self) -> FloatArray:
        """(m,) `RunNoise.miss_rate` of each map."""
        return np.array([m.noise.miss_rate for m in self.maps])

    @cached_property
    def phantom_rate(self) -> FloatArray:
        """(m,) `RunNoise.phantom_rate` of each map."""
        return np.array([m.noise.phantom_rate for m in self.maps])


def _whole(maps: Sequence[Prepared], vertex: IntArray, corridor: IntArray) -> Prepared:
    """The concatenated arrays of all maps."""

    def moved(columns: Iterable[IntArray], first: IntArray) -> IntArray:
        parts = zip(columns, first.tolist(), strict=False)
        return np.concatenate([rows + start for rows, start in parts])

    whole: dict[str, Any] = {
        name: np.concatenate([getattr(m, name) for m in maps])
        for name in (*OF_VERTICES, *OF_CORRIDORS)
    }
    by_branch = _wide(maps, "by_branch", -1)
    by_branch += np.where(by_branch < 0, 0, corridor[:-1].repeat(np.diff(vertex))[:, None])
    tail, head = (moved((getattr(m, end) for m in maps), vertex) for end in ("tail", "head"))
    row = moved((m.by_ends.row for m in maps), corridor)
    points = [m.points for m in maps]
    neighbours = [m.neighbours for m in maps]
    whole |= {
        "branch_unit": _wide(maps, "branch_unit", 0.0),
        "turn_rarity": _wide(maps, "turn_rarity", 0.0),
        "by_branch": by_branch,
        "neighbours": replace(
            joined(neighbours), index=moved((part.index for part in neighbours), vertex)
        ),
        "tail": tail,
        "head": head,
        "reverse": moved((m.reverse for m in maps), corridor),
        "by_ends": CorridorsByEnds(tail[row] * len(whole["z"]) + head[row], row),
        "points": replace(
            joined(points),
            edge=moved((part.edge for part in points), corridor),
            tail=moved((part.tail for part in points), vertex),
            head=moved((part.head for part in points), vertex),
        ),
    }
    # Arrays that are not concatenated are left empty, so that they cannot be used by mistake.
    first = {f.name: getattr(maps[0], f.name) for f in fields(Prepared)}
    nothing = {name: rows[:0] for name, rows in first.items() if isinstance(rows, np.ndarray)}
    return replace(maps[0], **(nothing | whole))


def _wide(maps: Sequence[Prepared], name: str, padding: complex) -> NDArray[Any]:
    """Rows of different widths, padded to the widest."""
    blocks = [getattr(m, name) for m in maps]
    widest = max(block.shape[1] for block in blocks)
    out = np.full((sum(map(len, blocks)), widest), padding, blocks[0].dtype)
    start = 0
    for block in blocks:
        out[start : start + len(block), : block.shape[1]] = block
        start += len(block)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Lanes:
    """l hypotheses of pairs of maps side by side, one lane each. The t rows are the second maps'
    vertices.

    of_a, of_b: (l,) the two maps in the atlases a and b; first: (l + 1,) first row of each lane;
    lane, vertex: (t,) lane and vertex of b of each row; shift: (l,) row of a vertex of b, minus the
    vertex; first_a, shift_a: the same for rows of the vertices of the first maps.
    """

    a: Atlas
    b: Atlas
    of_a: IntArray
    of_b: IntArray
    first: IntArray
    lane: IntArray
    vertex: IntArray
    shift: IntArray
    first_a: IntArray
    shift_a: IntArray

    @classmethod
    def of(cls, a: Atlas, b: Atlas, of_a: IntArray, of_b: IntArray) -> Lanes:
        """The lanes of pairs of maps of_a, of_b (l,)."""
        first = np.zeros(len(of_b) + 1, np.int64)
        first_a = np.zeros(len(of_a) + 1, np.int64)
        size = b.vertex[of_b + 1] - b.vertex[of_b]
        size.cumsum(out=first[1:])
        (a.vertex[of_a + 1] - a.vertex[of_a]).cumsum(out=first_a[1:])
        lane = np.arange(len(of_b)).repeat(size)
        shift = first[:-1] - b.vertex[of_b]
        vertex = np.arange(len(lane)) - shift[lane]
        shift_a = first_a[:-1] - a.vertex[of_a]
        return cls(a, b, of_a, of_b, first, lane, vertex, shift, first_a, shift_a)

    def __len__(self) -> int:
        return len(self.of_b)

    def take(self, lanes: IntArray) -> Lanes:
        """The given lanes only."""
        return Lanes.of(self.a, self.b, self.of_a[lanes], self.of_b[lanes])

    def rows_of(self, first: IntArray) -> tuple[IntArray, IntArray]:
        """(k,) each: lane and row in `b` of all points, or corridors, of the lanes' second maps.
        first: `b.point` or `b.corridor`."""
        lane, nth = numbered(np.diff(first)[self.of_b])
        return lane, first[self.of_b[lane]] + nth

    def nearest(
        self,
        where: ComplexArray,
        lane: IntArray,
        within_m: float | FloatArray,
        *,
        corridors: bool = False,
    ) -> tuple[FloatArray, IntArray]:
        """(k,) each: distance [m] from points to the nearest vertex, or point of a corridor
        (`corridors`), of the first map of their lane, and its index in the atlas.

        where: (k,) x + iy [m] in the first map; lane: (k,) ascending; within_m: a bound, or one per
        lane: of points beyond it only that is known.
        """
        gap, index = np.empty(len(where)), np.empty(len(where), np.int64)
        stops = np.cumsum(np.bincount(lane, minlength=len(self))).tolist()
        bounds = np.broadcast_to(within_m, len(stops)).tolist()
        first_index = (self.a.point if corridors else self.a.vertex)[self.of_a].tolist()
        start = 0
        for k, (stop, map_number) in enumerate(zip(stops, self.of_a.tolist(), strict=True)):
            if stop > start:
                topomap = self.a.maps[map_number]
                points = topomap.nearest_point if corridors else topomap.nearest_junction
                gap[start:stop], nearest = points.nearest(where[start:stop], bounds[k])
                np.add(nearest, first_index[k], out=index[start:stop])
            start = stop
        return gap, index


def cuts(lane: IntArray, lanes: int) -> list[int]:
    """(lanes + 1,) first row of each lane; lane: ascending."""
    return [0, *np.cumsum(np.bincount(lane, minlength=lanes)).tolist()]
