"""Maps end to end: every row is the map's own, moved."""

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest

from topobatch.merge.robust.atlas import Atlas, Lanes
from topobatch.merge.robust.prepare import Prepared, prepare

MOVED = {
    "halves.half": "vertex",
    "neighbours.index": "vertex",
    "tail": "vertex",
    "head": "vertex",
    "points.tail": "vertex",
    "points.head": "vertex",
    "reverse": "corridor",
    "by_ends.row": "corridor",
    "points.edge": "corridor",
}
"""Arrays that number rows, and of what."""


@pytest.fixture(scope="module")
def maps(halves):
    return [prepare(m) for m in (*halves, halves[0])]


@pytest.fixture(scope="module")
def atlas(maps):
    return Atlas.of(maps)


def arrays_of(m):
    """The arrays of a prepared map, and of its tables, by name."""
    own = {f.name: getattr(m, f.name) for f in fields(Prepared)}
    for name in ("neighbours", "by_ends", "points", "halves"):
        own |= {f"{name}.{f.name}": getattr(own[name], f.name) for f in fields(own[name])}
    return {name: value for name, value in own.items() if isinstance(value, np.ndarray)}


def parts(atlas, value):
    """The rows of each map."""
    firsts = (atlas.vertex, atlas.corridor, atlas.point)
    (first,) = {tuple(first.tolist()) for first in firsts if first[-1] == len(value)}
    return [value[start:stop] for start, stop in pairwise(first)]


def test_arrays_are_those_of_the_maps_or_empty(maps, atlas):
    joined = 0
    owned = [arrays_of(m) for m in maps]
    for name, value in arrays_of(atlas.whole).items():
        if not len(value):
            continue
        joined += 1
        for k, (m, rows) in enumerate(zip(maps, parts(atlas, value), strict=True)):
            own = owned[k][name]
            if name in MOVED:
                own = own + getattr(atlas, MOVED[name])[k]
            elif name == "by_branch":
                own = np.where(own < 0, -1, own + atlas.corridor[k])
            elif name == "by_ends.key":
                tail, head = own // len(m), own % len(m)
                own = (tail + atlas.vertex[k]) * len(atlas.whole) + head + atlas.vertex[k]
            wide = rows[:, own.shape[1] :] if own.ndim > 1 else rows[:0]
            assert (wide == (-1 if name == "by_branch" else 0)).all()
            assert np.array_equal(rows[:, : own.shape[1]] if own.ndim > 1 else rows, own), name
    assert joined > 25


def test_lanes_number_the_rows_of_second_maps(maps, atlas):
    of_a, of_b = np.array([0, 2, 1]), np.array([1, 1, 0])
    lanes = Lanes.of(atlas, atlas, of_a, of_b)
    for k, b in enumerate(of_b):
        rows = np.flatnonzero(lanes.lane == k)
        assert rows.tolist() == list(range(lanes.first[k], lanes.first[k + 1]))
        assert (lanes.vertex[rows] - atlas.vertex[b]).tolist() == list(range(len(maps[b])))
        assert (lanes.vertex[rows] + lanes.shift[k]).tolist() == rows.tolist()
    assert lanes.some(np.array([2])).lane.tolist() == [0] * len(maps[0])
    where = np.array([maps[0].z[3] + 0.1, maps[2].z[5] + 0.1j, maps[1].z[0]])
    gap, found = lanes.nearest(where, np.array([0, 1, 2]), 1.0)
    assert gap == pytest.approx([0.1, 0.1, 0.0])
    assert found.tolist() == [3, atlas.vertex[2] + 5, atlas.vertex[1]]
