"""Dead ends of what is known: where the robot turned round, its log or a grid ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IntArray
from .frozen import freeze, frozen_rows
from .passes import NO_BRANCH

TURNING_POINT, TRACK_END, FRONTIER = "turning_point", "track_end", "frontier"
KINDS = (TURNING_POINT, TRACK_END, FRONTIER)
"""The robot turned round; its log begins or ends; what a grid shows ends, and the way leads on."""

WAY_COLUMNS = ("length", "length_sigma", "traversals", "paths", "traversal_ns")
"""Fields of the corridors that lead to them, as of the edges of a map."""

ROWS: dict[str, tuple[type, int]] = {
    "paths": (np.float64, 2),
    "traversal_ns": (np.int64, 2),
    "time_ns": (np.int64, 1),
}
"""Fields that hold one array per turning point: its dtype and number of columns."""


@dataclass(frozen=True, slots=True, eq=False)
class TurningPoints:
    """Dead ends of k drives out of a junction and back, or only to it or from it.

    They are kept beside the vertices of a map: where a robot turns round is its own choice, so that
    they are not used to recognise places. kind: k of `KINDS`; vertex: (k,) vertex that the corridor
    starts at; branch: (k,) row-local branch of it, NO_BRANCH where unknown; heading: (k,) direction
    [rad] in which the corridor leaves the turning point; length, length_sigma: (k,) [m] along
    paths: k polylines (p, 2) [m] from the vertex to the point; position_sigma: (k,) [m] of the
    point; branch_sigma: (k,) [rad] of its heading; traversals: (k,) times driven; traversal_ns: k
    arrays (t, 2), by time: when the robot was at the vertex and at the point on each, empty where
    not known; time_ns: k arrays (q, 1): when it was at the point. Raises ValueError where shapes or
    values do not fit.
    """

    kind: tuple[str, ...]
    vertex: IntArray
    branch: IntArray
    heading: FloatArray
    length: FloatArray
    length_sigma: FloatArray
    position_sigma: FloatArray
    branch_sigma: FloatArray
    traversals: IntArray
    paths: tuple[FloatArray, ...]
    traversal_ns: tuple[IntArray, ...]
    time_ns: tuple[IntArray, ...]

    def __post_init__(self) -> None:
        k = len(self.kind)
        freeze(self, np.int64, vertex=(k,), branch=(k,), traversals=(k,))
        freeze(self, np.float64, heading=(k,), length=(k,), length_sigma=(k,))
        freeze(self, np.float64, position_sigma=(k,), branch_sigma=(k,))
        for name, (dtype, columns) in ROWS.items():
            parts = frozen_rows(getattr(self, name), dtype, columns, name)
            object.__setattr__(self, name, parts)
            if len(parts) != k:
                raise ValueError(f"{name} needs one array for each of {k} turning points")
        if any(len(path) < 2 for path in self.paths):
            raise ValueError("a path needs two points or more")
        if not set(self.kind) <= set(KINDS):
            raise ValueError(f"turning points are of the kinds {', '.join(KINDS)}")
        if np.any(self.vertex < 0) or np.any(self.branch < NO_BRANCH):
            raise ValueError("a turning point names no vertex, or no branch")
        if np.any(self.length <= 0) or np.any(self.length_sigma <= 0):
            raise ValueError("lengths and their sigmas must be positive")

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def xy(self) -> FloatArray:
        """(k, 2) positions [m]."""
        return np.array([path[-1] for path in self.paths], np.float64).reshape(-1, 2)


_NO_INTS, _NO_FLOATS = np.zeros(0, np.int64), np.zeros(0)
NO_TURNING_POINTS = TurningPoints(
    kind=(),
    vertex=_NO_INTS,
    branch=_NO_INTS,
    heading=_NO_FLOATS,
    length=_NO_FLOATS,
    length_sigma=_NO_FLOATS,
    position_sigma=_NO_FLOATS,
    branch_sigma=_NO_FLOATS,
    traversals=_NO_INTS,
    paths=(),
    traversal_ns=(),
    time_ns=(),
)
