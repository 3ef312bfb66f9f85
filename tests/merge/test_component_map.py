"""A component as a map, and when its corridors were driven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.component_map import component_map, component_pose_graph, stale_runs
from topobatch.merge.document import merged_to_document
from topobatch.merge.member_times import member_times
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.merging import merge_maps
from topobatch.merge.result import fused_confidence
from topobatch.topology.posegraph.solve import solve

S = 10**9


def timed(topomap, *times):
    return replace(topomap, traversal_ns=tuple(np.array(t, np.int64).reshape(-1, 2) for t in times))


def test_a_fused_vertex_is_as_sure_as_its_members_by_their_passes(draw) -> None:
    a = draw("a", {"A": (0, 0), "B": (3, 0)}, [("A", "B")])
    b = draw("b", {"A": (0, 0), "B": (3, 0)}, [("A", "B")])
    a = replace(
        a, confidence=[0.4, 1.0], observation_vertex=[0, 0, 0], observation_time_ns=[1, 2, 3]
    )
    b = replace(b, observation_vertex=[0, 1], observation_time_ns=[4, 5])
    members = [{"a": (0,), "b": (0,)}, {"a": (1,)}, {"b": (1,)}, {"a": (0, 1)}]
    sure = fused_confidence(members, {"a": a, "b": b})
    # By three passes and one; a vertex without passes counts like one.
    assert sure == pytest.approx([(3 * 0.4 + 1) / 4, 1.0, 1.0, (3 * 0.4 + 1) / 4])


def test_a_corridor_past_an_unseen_junction_gives_each_part_its_share(draw) -> None:
    """b drove from A to C and back, and did not see B, a third of the way from A."""
    three = {"A": (0, 0), "B": (3, 0), "C": (9, 0)}
    a = timed(draw("a", three, [("A", "B"), ("B", "C")]), [(10 * S, 13 * S)], [(26 * S, 20 * S)])
    b = draw("b", {"A": (0, 0), "C": (9, 0)}, [("A", "C")])
    b = timed(b, [(100 * S, 109 * S), (218 * S, 200 * S)])
    first, second = member_times(
        {"a": a, "b": b},
        [[("a", 0), ("b", 0)], [("a", 1), ("b", 0)]],
        fused_of={("a", 0): 0, ("a", 1): 1, ("a", 2): 2, ("b", 0): 0, ("b", 1): 2},
        source=np.array([0, 1]),
        target=np.array([1, 2]),
        length=np.array([3.0, 6.0]),
    )
    # (at A, at B) and (at B, at C), by time.
    assert (first / S).tolist() == [[10, 13], [100, 103], [218, 212]]
    assert (second / S).tolist() == [[26, 20], [103, 109], [212, 200]]


@pytest.fixture(scope="module")
def merged(maze_pair):
    """Two maps of a maze whose corridors were driven at 1 m/s, and their merge."""
    maps = []
    for m in maze_pair(3)[:2]:
        at = np.round(m.length * S).astype(np.int64)
        maps.append(timed(m, *([(0, t)] for t in at.tolist())))
    document = MergedDocument.model_validate(merged_to_document(merge_maps(maps)))
    return document, {m.run: m for m in maps}


def test_a_component_is_the_fused_map_with_the_times_of_all_runs(merged) -> None:
    document, maps = merged
    found = component_map(document, 0, "site", maps)
    assert found.run == found.frame == "site"
    assert len(found) == len(document.nodes)
    assert found.xy.tolist() == [[node.x, node.y] for node in document.nodes]
    assert len(found.observation_vertex) == sum(len(m.observation_vertex) for m in maps.values())
    for e, times in enumerate(found.traversal_ns):
        assert len(times) == found.traversals[e]
        assert np.allclose(np.abs(np.diff(times, axis=1)) / S, found.length[e], rtol=0.1)
    assert component_map(document, 0, "site").traversal_ns is None
    with pytest.raises(ValueError, match="no component 5"):
        component_map(document, 5, "site")


def test_maps_that_are_not_those_that_were_merged_are_told(merged) -> None:
    document, maps = merged
    assert stale_runs(document, 0, maps) == {}
    assert stale_runs(document, 0, {"a": maps["a"]}) == {"b": "is not there"}
    later = replace(maps["b"], observation_time_ns=maps["b"].observation_time_ns + 1)
    changed = maps | {"b": later}
    assert stale_runs(document, 0, changed) == {"b": "has changed since"}
    assert component_map(document, 0, "site", changed).traversal_ns is None


def test_the_joint_pose_graph_lies_at_its_minimum(merged) -> None:
    document, maps = merged
    graph = component_pose_graph(document, 0, maps)
    assert len(graph) == sum(len(m) for m in maps.values())
    assert len(graph.source) > sum(len(m.source) for m in maps.values())
    xy = {node.id: (node.x, node.y) for node in document.nodes}
    first = {v: xy[node.id] for node in document.nodes for v in node.members.get("a", ())}
    assert np.allclose(
        graph.pose[: len(maps["a"]), :2], [first[v] for v in sorted(first)], atol=0.1
    )
    again = solve(graph).pose[:, :2]
    shift = again - graph.pose[:, :2]
    assert np.hypot(*(shift - shift.mean(axis=0)).T).max() < 0.5
