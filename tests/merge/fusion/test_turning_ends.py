"""Where turning points of runs stand in their fused map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.component_map import component_map, stale_runs
from topobatch.merge.document import merged_to_document, result_from_document
from topobatch.merge.fusion.fuse import fuse
from topobatch.merge.fusion.turning_ends import with_turning_ends
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.result import Alignment, MergeResult, PairVerdict, Verdict
from topobatch.topology.document import map_to_document
from topobatch.topology.passes import NO_BRANCH
from topobatch.topology.se2 import apply
from topobatch.topology.turning_points import TURNING_POINT, TurningPoints

MOVED = (3.0, -7.0, 2.1)
WAY = {"a": (0, 0), "b": (10, 0), "c": (18, 0)}
NORTH = np.pi / 2


def way(draw, run, T=(0.0, 0.0, 0.0), rooms=("a", "b", "c")):
    """Three junctions in a row, with rooms to the north of some."""
    stubs = [(name, NORTH) for name in rooms]
    return draw(run, WAY, [("a", "b"), ("b", "c")], stubs, T=T)


def turned(m, deep, T=(0.0, 0.0, 0.0), branch=True):
    """The map with a drive into the room of each vertex in deep, so many metres."""
    T, k = np.array(T), len(deep)
    heading = NORTH + T[2]
    own = np.array(list(deep), np.int64)
    length = np.array(list(deep.values()), float)
    off = [np.cos(m.branches[v] - heading) for v in own.tolist()]
    tips = m.xy[own] + length[:, None] * [np.cos(heading), np.sin(heading)]
    points = TurningPoints(
        kind=(TURNING_POINT,) * k,
        vertex=own,
        branch=[int(o.argmax()) if branch else NO_BRANCH for o in off],
        heading=np.full(k, heading - np.pi),
        length=length,
        length_sigma=np.full(k, 0.1),
        position_sigma=np.full(k, 0.2),
        branch_sigma=np.full(k, 0.1),
        traversals=np.full(k, 2),
        paths=tuple(np.stack([m.xy[v], tip]) for v, tip in zip(own.tolist(), tips, strict=True)),
        traversal_ns=tuple(np.array([[5, 6], [9, 8]]) for _ in deep),
        time_ns=tuple(np.array([[7 + v]]) for v in own.tolist()),
    )
    return replace(m, turning_points=points)


def matched(a, b, vertices=(0, 1, 2), T=MOVED):
    best = Alignment(np.array(T), 20.0, [(v, v) for v in vertices], 0.0)
    return PairVerdict(a.run, b.run, Verdict.MERGED, True, 20.0, "", best=best)


def fused_with(maps, verdicts):
    components, fused = fuse(maps, verdicts)
    return components, fused, with_turning_ends(fused, components, maps)


def test_two_runs_in_one_room_have_one_end_and_in_two_rooms_two(draw):
    a, b = way(draw, "a", MOVED), way(draw, "b")
    a = turned(a, {0: 3.0, 1: 4.0}, MOVED)
    b = turned(b, {1: 3.5, 2: 2.0})
    _, plain, fused = fused_with([a, b], [matched(a, b)])
    assert (fused.turned, fused.junctions, len(plain)) == (3, 3, 3)
    assert fused.members[3:] == ({"a": (3,)}, {"a": (4,), "b": (3,)}, {"b": (4,)})
    assert fused.edge_members[2:] == ((("a", 2),), (("a", 3), ("b", 2)), (("b", 3),))
    assert fused.length[2:].tolist() == [3.0, 4.0, 2.0]
    assert fused.traversals[2:].tolist() == [2, 4, 2]
    assert fused.observations[4] == (("a", 8), ("b", 8))
    truth = apply(np.array(MOVED), np.array([(0, 3), (10, 4), (18, 2)], float))
    np.testing.assert_allclose(fused.xy[3:], truth, atol=1e-6)
    # Nothing else is moved by them.
    np.testing.assert_array_equal(fused.xy[:3], plain.xy)
    assert fused.edge_members[:2] == plain.edge_members


def test_where_another_run_drove_on_there_is_no_end(draw):
    a = turned(way(draw, "a"), {1: 4.0})
    far = {**WAY, "d": (10, 9)}
    b = draw("b", far, [("a", "b"), ("b", "c"), ("b", "d")])
    _, _, fused = fused_with([a, b], [matched(a, b, T=(0, 0, 0))])
    assert (fused.turned, len(fused)) == (0, 4)


@pytest.fixture(name="two")
def _two(draw):
    a, b = turned(way(draw, "a", MOVED), {0: 3.0, 1: 4.0}, MOVED), turned(way(draw, "b"), {1: 3.5})
    components, _, fused = fused_with([a, b], [matched(a, b)])
    return {"a": a, "b": b}, MergeResult(components, fused, (matched(a, b),))


def test_the_document_has_them_last_and_gives_them_back(two):
    maps, result = two
    doc = MergedDocument.model_validate(merged_to_document(result))
    assert [node.kind for node in doc.nodes][3:] == ["turning_point"] * 2
    again = result_from_document(doc)
    assert (again.fused.turned, again.fused.members) == (2, result.fused.members)
    assert stale_runs(again, 0, maps) == {}
    whole = component_map(again, 0, "both")
    assert (len(whole), len(whole.source), len(whole.turning_points)) == (3, 2, 2)
    assert len(map_to_document(whole)["nodes"]) == len(whole.info["members"]["nodes"])
