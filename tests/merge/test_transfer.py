"""Places carried from map to map: exact where maps are, honest where they bend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.merge.component_map import component_map
from topobatch.merge.merging import merge_maps
from topobatch.merge.transfer import (
    MatchedJunctions,
    junctions_of_merged,
    junctions_of_runs,
    transfer,
)
from topobatch.topology.se2 import apply

GRID = np.array([(x, y) for x in range(0, 50, 10) for y in range(0, 30, 10)], float)
PLACES = np.array([(3.0, 4.0), (22.0, 11.0), (41.0, 19.0)])
T = np.array([5.0, -3.0, 0.7])


def matched(target: np.ndarray, source: np.ndarray = GRID, **more) -> MatchedJunctions:
    k = len(source)
    given = {
        "sigma": np.full(k, 0.03),
        "turn": np.full(k, T[2]),
        "turn_sigma": np.full(k, 0.05),
        "bending": 1e-3,
        "turning": 1e-4,
    }
    return MatchedJunctions(source=source, target=target, **(given | more))


def test_rigid_maps_are_carried_exactly() -> None:
    found = transfer(PLACES, matched(apply(T, GRID)))
    assert np.allclose(found.xy, apply(T, PLACES), atol=1e-6)
    assert np.allclose(found.turn, T[2])
    assert np.allclose(found.nearest_m, [5.0, np.hypot(2, 1), np.hypot(1, 1)])


def test_a_bent_map_is_carried_along_its_bend() -> None:
    """A global transform would be metres off."""
    angle = GRID[:, 0] / 60
    bent = np.column_stack([60 * np.sin(angle), 60 - (60 - GRID[:, 1]) * np.cos(angle)])
    bent[:, 0] = (60 - GRID[:, 1]) * np.sin(angle)
    found = transfer(PLACES, matched(bent, turn=angle, turn_sigma=np.full(len(GRID), 0.03)))
    a = PLACES[:, 0] / 60
    true = np.column_stack([(60 - PLACES[:, 1]) * np.sin(a), 60 - (60 - PLACES[:, 1]) * np.cos(a)])
    off = np.hypot(*(found.xy - true).T)
    assert off.max() < 0.5
    assert np.all(off < 3 * found.sigma_m)


def test_merged_runs_say_what_they_have_in_common(maze_pair) -> None:
    a, b, truth = maze_pair(3)
    maps = {m.run: m for m in (a, b)}
    result = merge_maps([a, b])
    assert len(result.components) == 1
    both = junctions_of_runs(result, maps, "a", "b")
    known = {tuple(a.xy[u]): b.xy[v] for u, v in truth.tolist()}
    assert len(both) >= len(truth) / 2
    assert all(
        np.allclose(known[tuple(s)], t) for s, t in zip(both.source, both.target, strict=True)
    )
    middle = a.xy[truth[:, 0]]
    found = transfer(middle, both)
    assert np.hypot(*(found.xy - b.xy[truth[:, 1]]).T).max() < 0.3
    fused = component_map(result, 0, "merged")
    own = junctions_of_merged(result, a, fused)
    assert len(own) == len(a)
    there = transfer(a.xy, own)
    of = {tuple(x): y for x, y in zip(own.source, own.target, strict=True)}
    assert np.hypot(*(there.xy - [of[tuple(x)] for x in a.xy]).T).max() < 0.1
    again = transfer(there.xy, replace(own, source=own.target, target=own.source, turn=-own.turn))
    assert np.hypot(*(again.xy - a.xy).T).max() < 0.1
