"""Fusion of maps by accepted verdicts into one map (§4).

Independent of the method: only matched vertices, transforms and ties of accepted pairs are used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined
from ...topology.ragged import Ragged
from ...topology.topomap import TopoMap
from ..codec import from_bytes, to_bytes
from ..kept import Kept, Kind, digested
from ..result import Component, FusedMap, PairVerdict, Spread, by_run
from .edge_splitting import split_at_places
from .edges import Corridor, corridors_of, fuse_corridors
from .joint_graph import (
    Joint,
    fitted_poses,
    measured_across,
    measured_within,
    optimise_poses,
    pass_counts,
    run_poses,
)
from .places import Place, fused_branches, fused_places
from .uncertainty import fused_sigmas
from .vertex_partition import Groups, Pool, coincident, matched_groups


def fuse(
    maps: Sequence[TopoMap],
    verdicts: Sequence[PairVerdict],
    *,
    sigmas: bool = False,
    kept: Kept | None = None,
) -> tuple[tuple[Component, ...], FusedMap]:
    """Components of runs joined by accepted verdicts, and the fused map of all of them.

    A component's frame is that of its first run by name. Positions are from one joint pose graph
    over all vertices of a component; vertices are fused by matched pairs, transitively, and where
    they coincide afterwards. Components, vertices and edges are numbered by run name and vertex,
    independent of the input's order. A run without a match is a component of its own, with its map
    unchanged.

    sigmas: whether every component's `spread`, and the sigmas of vertices and corridors, are
    computed. kept: store of components fused before, which are not fused again.
    """
    by_name = {m.run: m for m in sorted(maps, key=lambda m: m.run)}
    accepted = [v for v in verdicts if v.accepted and v.a in by_name and v.b in by_name]
    groups = components_of(by_name, accepted)
    component_of = {run: k for k, runs in enumerate(groups) for run in runs}
    inside: list[list[PairVerdict]] = [[] for _ in groups]
    for v in accepted:
        inside[component_of[v.a]].append(v)
    kept = kept or Kept()
    fused_parts = [
        fused_once([by_name[run] for run in runs], part, sigmas=sigmas, kept=kept)
        for runs, part in zip(groups, inside, strict=True)
    ]
    components = tuple(replace(part, id=k) for k, (part, _) in enumerate(fused_parts))
    return components, _concatenated([fused for _, fused in fused_parts])


Fused = tuple[Component, FusedMap]
"""One component, and its part of the fused map, both numbered from 0."""

CLASSES = {cls.__name__: cls for cls in (Component, FusedMap, Spread, Ragged)}
"""What a kept component consists of."""


def components_of(runs: Mapping[str, object], accepted: Sequence[PairVerdict]) -> list[list[str]]:
    """Runs connected by accepted verdicts, each list sorted, lists by their first runs."""
    partition = DisjointSet(runs)
    for v in accepted:
        partition.merge(v.a, v.b)
    return sorted(sorted(component) for component in partition.subsets())


def fused_once(
    maps: Sequence[TopoMap], inside: Sequence[PairVerdict], *, sigmas: bool, kept: Kept
) -> Fused:
    """`fuse_component`, cached in `kept`."""
    digest = component_digest(maps, inside, kept, sigmas=sigmas)
    made = partial(fuse_component, maps, inside, sigmas=sigmas)
    data = kept.result(Kind.COMPONENT, (digest, digest), lambda: to_bytes(made()))
    found: Fused = from_bytes(data, CLASSES)
    return found


def component_digest(
    maps: Sequence[TopoMap], inside: Sequence[PairVerdict], kept: Kept, *, sigmas: bool = False
) -> bytes:
    """A digest of everything that a component depends on: its maps and their names, the matches
    and ties that join them, strongest first, and whether sigmas are computed; not of evidence."""
    number = {m.run: k for k, m in enumerate(maps)}
    parts = [repr(([m.run for m in maps], sigmas)).encode(), *map(kept.digest, maps)]
    for v in sorted(inside, key=lambda v: (-v.evidence_bits, v.a, v.b)):
        if v.best is not None:
            parts.append(f"{number[v.a]} {number[v.b]} {len(v.best.matched)};".encode())
            parts += [v.best.transform.tobytes(), v.best.matched.tobytes()]
            ties = v.best.ties
            of_ties = (ties.source, ties.target, ties.measurement, ties.information)
            parts += [array.tobytes() for array in of_ties]
    return digested(*parts)


def fuse_component(
    maps: Sequence[TopoMap], inside: Sequence[PairVerdict], *, sigmas: bool = False
) -> Fused:
    """Fuse one component, in the frame of its first map. inside: accepted verdicts that connect its
    runs; sigmas: whether to compute the uncertainties of positions and lengths."""
    pool = Pool.of(maps)
    groups = matched_groups(pool, inside)
    joint = _fuse_coincident(pool, groups, run_poses(list(pool.first), inside), inside)
    label = groups.labels()
    xy = _place_positions(pool, label, joint.pose)
    places = fused_places(pool, label, joint.pose)
    corridors = corridors_of(pool, label, joint.pose, xy, fused_branches(places))
    if len(pool.maps) > 1:
        corridors = split_at_places(fuse_corridors(corridors))
    component = Component(0, fitted_poses(pool, joint.pose))
    fused = _fused_map(pool, xy, places, corridors)
    if not sigmas:
        return component, fused
    if joint.graph is None or joint.solution is None:  # one run: the sigmas of its map
        return component, replace(fused, position_sigma=pool.maps[0].position_sigma)
    of_places, of_lengths, spread = fused_sigmas(
        pool, label, joint.graph, joint.solution, corridors
    )
    fused = replace(fused, position_sigma=of_places, length_sigma=of_lengths)
    return replace(component, spread=spread), fused


def _fuse_coincident(
    pool: Pool, groups: Groups, start: Mapping[str, FloatArray], inside: Sequence[PairVerdict]
) -> Joint:
    """Optimise the positions and fuse coincident vertices alternately, until there are none:
    changes `groups`, returns the positions."""
    if len(pool.maps) < 2:
        return optimise_poses(pool, groups.labels(), start)
    within, across = measured_within(pool), measured_across(pool, inside)
    while True:
        joint = optimise_poses(pool, groups.labels(), start, within, across)
        fused = [groups.join(u, v) for u, v in coincident(pool, groups, joint.pose)]
        if not any(fused):
            return joint


def _place_positions(pool: Pool, label: IntArray, pose: FloatArray) -> FloatArray:
    """(places, 2) mean positions [m], weighted by passes."""
    weight = pass_counts(pool).astype(np.float64)
    total = np.bincount(label, weight)
    columns = [np.bincount(label, weight * pose[:, k]) / total for k in (0, 1)]
    return np.stack(columns, axis=-1)


# --- places and corridors as a map, and the concatenation of components ---------------------------


def observations_of(
    maps: Sequence[TopoMap], members: Sequence[Mapping[str, tuple[int, ...]]]
) -> tuple[tuple[tuple[str, int], ...], ...]:
    """For every place the passes of all its members as (run, time), sorted."""
    place_of = {m.run: np.zeros(len(m), np.int64) for m in maps}
    for k, member in enumerate(members):
        for run, vertices in member.items():
            place_of[run][list(vertices)] = k
    observations: list[list[tuple[str, int]]] = [[] for _ in members]
    for m in maps:
        rows = place_of[m.run][m.observation_vertex].tolist()
        for k, time_ns in zip(rows, m.observation_time_ns.tolist(), strict=True):
            observations[k].append((m.run, time_ns))
    return tuple(tuple(sorted(passes)) for passes in observations)


def _fused_map(
    pool: Pool, xy: FloatArray, places: Sequence[Place], corridors: Sequence[Corridor]
) -> FusedMap:
    """Places and corridors as a fused map of one component. xy: (places, 2) [m]."""
    members = tuple(
        by_run((pool.maps[pool.run[row]].run, int(pool.vertex[row])) for row in place.rows)
        for place in places
    )
    return FusedMap(
        component=np.zeros(len(places), np.int64),
        xy=xy,
        branches=Ragged.from_rows(place.headings for place in places),
        kind=tuple(place.kind for place in places),
        members=members,
        observations=observations_of(pool.maps, members),
        source=np.array([c.u for c in corridors], np.int64),
        target=np.array([c.v for c in corridors], np.int64),
        source_branch=np.array([c.branch_u for c in corridors], np.int64),
        target_branch=np.array([c.branch_v for c in corridors], np.int64),
        length=np.array([c.length for c in corridors], np.float64),
        length_sigma=np.array([c.sigma for c in corridors], np.float64),
        traversals=np.array([c.traversals for c in corridors], np.int64),
        paths=tuple(c.path for c in corridors),
        edge_members=tuple(c.members for c in corridors),
    )


def _concatenated(parts: Sequence[FusedMap]) -> FusedMap:
    """All components in one FusedMap, with consecutive vertex numbers. `position_sigma` is NaN for
    components without it, and None if no component has it."""
    if any(p.position_sigma is not None for p in parts):
        parts = [
            replace(p, position_sigma=np.full(len(p), np.nan)) if p.position_sigma is None else p
            for p in parts
        ]
    sizes = [len(p) for p in parts]
    first = np.cumsum([0, *sizes])[:-1].repeat([len(p.source) for p in parts])
    whole = joined(parts or [_fused_map(Pool.of([]), np.zeros((0, 2)), [], [])])
    return replace(
        whole,
        component=np.repeat(np.arange(len(parts)), sizes),
        source=whole.source + first,
        target=whole.target + first,
    )
