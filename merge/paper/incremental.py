"""Merging again after maps have grown (§4.2): what was found before is verified, not sought.

The links between corridors that neither map changed are kept, the others are found anew, and the
components are assembled again: surviving hypotheses are verified and expanded or eliminated, new
ones come from what is new, and the result is that of growing from scratch.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...topology.matching.association import (
    Growth,
    assemble,
    confirm_links,
    find_links,
    join_links,
    search_bound,
)
from ...topology.matching.correspondence import DEFAULT_GROWTH, GrowthSettings
from ...topology.matching.structure import Structure, prepare
from ...topology.topomap import TopoMap

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class GrownPair:
    """Two maps as they were and all that was found between them.

    kept: links taken over from before; sought: forward corridors of a that were compared anew.
    """

    a: Structure
    b: Structure
    keys: tuple[tuple[bytes, ...], tuple[bytes, ...]]
    growth: Growth
    kept: int = 0
    sought: int = 0


def grow_pair(a: TopoMap, b: TopoMap, settings: GrowthSettings = DEFAULT_GROWTH) -> GrownPair:
    """Grow all matches of two maps from scratch, ready to be grown again."""
    sa, sb = prepare(a), prepare(b)
    links = find_links(sa, sb, settings)
    keys = (_dart_keys(a, sa), _dart_keys(b, sb))
    return GrownPair(sa, sb, keys, assemble(sa, sb, links, settings), 0, len(sa.start) // 2)


def grow_again(
    before: GrownPair, a: TopoMap, b: TopoMap, settings: GrowthSettings = DEFAULT_GROWTH
) -> GrownPair:
    """The same as `grow_pair(a, b)`, comparing only corridors that are new or have changed.

    A corridor is unchanged if its length, its branches and the branches of both its junctions are;
    junctions are recognised by their first pass, so they may be renumbered. Where the smaller map
    has outgrown the bound on lengths (`search_bound`: at most once each time it doubles), all
    corridors are compared anew.
    """
    sa, sb = prepare(a), prepare(b)
    if search_bound(sa, sb, settings) != search_bound(before.a, before.b, settings):
        return grow_pair(a, b, settings)
    keys = (_dart_keys(a, sa), _dart_keys(b, sb))
    new_a, new_b = (_known(old, new) for old, new in zip(before.keys, keys, strict=True))
    links = before.growth.links
    old_a, old_b = new_a[links.dart_a], new_b[links.dart_b]
    # Links are of forward darts of a: one that is now driven backwards is sought again.
    stays = (old_a >= 0) & (old_b >= 0) & (old_a % 2 == 0)
    verified = confirm_links(sa, sb, old_a[stays], old_b[stays], settings)
    fresh_a, fresh_b = _fresh(sa, new_a), _fresh(sb, new_b)
    forward = np.arange(0, len(sa.start), 2)
    old_forward = np.setdiff1d(forward, fresh_a)
    parts = [
        verified,
        find_links(sa, sb, settings, np.intersect1d(forward, fresh_a), None),
        find_links(sa, sb, settings, old_forward, fresh_b),
    ]
    growth = assemble(sa, sb, join_links(parts), settings)
    return GrownPair(sa, sb, keys, growth, len(verified.start), len(forward) - len(old_forward))


def _dart_keys(topomap: TopoMap, s: Structure) -> tuple[bytes, ...]:
    """What the compatibility of every dart depends on, and which dart it is, as bytes."""
    first = np.full(len(s), -1, np.int64)
    seen, row = np.unique(topomap.observation_vertex, return_index=True)
    first[seen] = topomap.observation_time_ns[row]
    ends = np.stack([first[s.start], first[s.end], s.out_branch, s.in_branch], axis=1)
    measured = np.stack([s.length, s.sigma], axis=1)
    headings = np.stack([s.heading[s.start], s.heading[s.end]], axis=1).reshape(len(s.start), -1)
    places = np.stack([s.slot[s.start], s.slot[s.end]], axis=1).reshape(len(s.start), -1)
    forward = np.arange(len(s.start)) % 2
    return tuple(
        ends[k].tobytes()
        + measured[k].tobytes()
        + headings[k][~np.isnan(headings[k])].tobytes()
        + places[k][places[k] >= 0].tobytes()
        + forward[k].tobytes()
        for k in range(len(s.start))
    )


def _known(old: tuple[bytes, ...], new: tuple[bytes, ...]) -> IntArray:
    """For each old dart the new dart that is unchanged, -1 for none (or more than one)."""
    place: dict[bytes, int] = {}
    for k, key in enumerate(new):
        place[key] = -1 if key in place else k
    count = Counter(old)
    return np.array([place.get(k, -1) if count[k] == 1 else -1 for k in old], np.int64)


def _fresh(s: Structure, known: IntArray) -> IntArray:
    """Darts that are not an unchanged old one."""
    return np.setdiff1d(np.arange(len(s.start)), known[known >= 0])
