"""A component as a map, and when its corridors were driven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.component_map import component_map, stale_runs
from topobatch.merge.merging import merge_maps

S = 10**9


def timed(topomap, *times):
    return replace(topomap, traversal_ns=tuple(np.array(t, np.int64).reshape(-1, 2) for t in times))


@pytest.fixture(scope="module")
def merged(maze_pair):
    """Two maps of a maze whose corridors were driven at 1 m/s, and their merge."""
    maps = []
    for m in maze_pair(3)[:2]:
        at = np.round(m.length * S).astype(np.int64)
        maps.append(timed(m, *([(0, t)] for t in at.tolist())))
    result = merge_maps(maps)
    return result, {m.run: m for m in maps}


def test_a_component_is_the_fused_map_with_the_times_of_all_runs(merged) -> None:
    result, maps = merged
    found = component_map(result, 0, "site", maps)
    assert found.run == found.frame == "site"
    assert np.array_equal(found.xy, result.fused.xy)
    assert len(found.observation_vertex) == sum(len(m.observation_vertex) for m in maps.values())
    for e, times in enumerate(found.traversal_ns):
        assert len(times) == found.traversals[e]
        assert np.allclose(np.abs(np.diff(times, axis=1)) / S, found.length[e], rtol=0.1)
    assert component_map(result, 0, "site").traversal_ns is None
    with pytest.raises(ValueError, match="no component 5"):
        component_map(result, 5, "site")


def test_maps_that_are_not_those_that_were_merged_are_told(merged) -> None:
    result, maps = merged
    assert stale_runs(result, 0, maps) == {}
    assert stale_runs(result, 0, {"a": maps["a"]}) == {"b": "is not there"}
    later = replace(maps["b"], observation_time_ns=maps["b"].observation_time_ns + 1)
    changed = maps | {"b": later}
    assert stale_runs(result, 0, changed) == {"b": "has changed since"}
    assert component_map(result, 0, "site", changed).traversal_ns is None
