"""Mirror images: a mirrored copy of a wing has equal lengths, but is another place.

Along a straight line a map and its mirror image agree corridor by corridor, which chance does not
explain and nothing contradicts. But then the map itself and its mirror image fit equally well. So
the mirror image counts as another placement, which a correct one must lead. Of 144 pairs of equal
rows and tunnels, one map of each mirrored, two were merged without this.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...topology.arrays import IntArray
from ...topology.ragged import Ragged
from ...topology.se2 import wrap
from ...topology.topomap import TopoMap
from ...topology.views import NO_VIEWS


def mirrored(m: TopoMap) -> TopoMap:
    """The map with y and all headings negated, without views; vertices and corridors keep their
    numbers."""
    rows = [wrap(-m.branches[v]) for v in range(len(m))]
    order = [np.argsort(row, kind="stable") for row in rows]
    place = [np.argsort(o, kind="stable") for o in order]

    def branch(vertex: IntArray, index: IntArray) -> IntArray:
        pairs = zip(vertex.tolist(), index.tolist(), strict=True)
        return np.array([place[v][k] if k >= 0 else k for v, k in pairs], np.int64)

    flip = np.array([1.0, -1.0])
    return replace(
        m,
        xy=m.xy * flip,
        branches=Ragged.from_rows(row[o] for row, o in zip(rows, order, strict=True)),
        branch_sigma=None,
        source_branch=branch(m.source, m.source_branch),
        target_branch=branch(m.target, m.target_branch),
        paths=tuple(path * flip for path in m.paths),
        views=NO_VIEWS,
    )
