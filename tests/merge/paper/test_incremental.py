"""Growing again after maps have grown: what growing from scratch finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.paper.incremental import grow_again, grow_pair
from topobatch.topology.matching.correspondence import GrowthSettings


def state(pair):
    g = pair.growth
    return [
        x.tolist()
        for x in (
            g.nodes.vertex_a,
            g.nodes.vertex_b,
            g.nodes.correspondence,
            g.component,
            g.rejected,
            np.column_stack([g.links.dart_a, g.links.dart_b])[
                np.lexsort((g.links.dart_b, g.links.dart_a))
            ],
        )
    ]


def younger(m, edges):
    """The map before some of its corridors were driven."""
    names = ("source", "target", "source_branch", "target_branch", "length", "length_sigma")
    cut = {name: getattr(m, name)[:edges] for name in (*names, "traversals")}
    return replace(m, paths=m.paths[:edges], **cut)


@pytest.mark.parametrize("world", ["auto", "general"])
@pytest.mark.parametrize("degree", ["exact", "inexact"])
def test_growing_again_gives_what_growing_from_scratch_gives(maze_pair, world, degree):
    settings = GrowthSettings(world, degree)
    for seed in range(3):
        a, b, _ = maze_pair(seed)
        old = grow_pair(younger(a, len(a.source) - 6), younger(b, len(b.source) - 4), settings)
        again = grow_again(old, a, b, settings)
        assert state(again) == state(grow_pair(a, b, settings))
        assert again.kept > 0
        assert again.sought < len(a.source)


def test_nothing_new_means_nothing_is_sought(maze_pair):
    a, b, _ = maze_pair(0)
    old = grow_pair(a, b)
    again = grow_again(old, a, b)
    assert again.sought == 0
    assert again.kept == len(old.growth.links.start)
    assert state(again) == state(old)


def test_changed_measurements_and_turned_corridors_are_sought_again(maze_pair):
    a, b, _ = maze_pair(2)
    old = grow_pair(a, b)
    length = a.length.copy()
    length[:3] += 1.0
    turned = replace(
        a,
        length=length,
        source=np.append(a.target[:1], a.source[1:]),
        target=np.append(a.source[:1], a.target[1:]),
        source_branch=np.append(a.target_branch[:1], a.source_branch[1:]),
        target_branch=np.append(a.source_branch[:1], a.target_branch[1:]),
    )
    again = grow_again(old, turned, b)
    assert state(again) == state(grow_pair(turned, b))
    assert again.sought >= 3


def test_renumbered_vertices_are_recognised_by_their_first_pass(maze_pair):
    a, b, _ = maze_pair(1)
    old = grow_pair(a, b)
    order = np.random.default_rng(0).permutation(len(a))
    place = np.argsort(order)
    renumbered = replace(
        a,
        xy=a.xy[order],
        branches=a.branches.take(order),
        kind=tuple(a.kind[v] for v in order),
        source=place[a.source],
        target=place[a.target],
        observation_vertex=place[a.observation_vertex],
    )
    again = grow_again(old, renumbered, b)
    assert again.sought == 0
    assert state(again) == state(grow_pair(renumbered, b))
