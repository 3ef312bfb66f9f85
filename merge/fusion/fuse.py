"""Maps and accepted verdicts to one fused map (§4).

Works on any method's verdicts: only the matched vertices and transforms of accepted pairs count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

from ...topology.ragged import Ragged
from ...topology.topomap import TopoMap
from ..result import Component, FusedMap, PairVerdict, Spread
from .data_association import DEFAULT_COINCIDENCE, CoincidenceSettings, coincident
from .edge_splitting import DEFAULT_PASSAGE, PassageSettings, split_at_places
from .edges import DEFAULT_CORRIDOR, Corridor, CorridorSettings, corridors_of, fuse_corridors
from .joint_graph import (
    DEFAULT_JOINT,
    Joint,
    JointSettings,
    fitted_poses,
    pass_counts,
    run_poses,
    settle,
)
from .places import DEFAULT_PLACE, Place, PlaceSettings, fused_places
from .uncertainty import spread
from .vertex_partition import Groups, Pool, identify

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """How maps of one component become one."""

    joint: JointSettings = DEFAULT_JOINT
    coincidence: CoincidenceSettings = DEFAULT_COINCIDENCE
    corridors: CorridorSettings = DEFAULT_CORRIDOR
    passages: PassageSettings = DEFAULT_PASSAGE
    rounds: int = 4
    """Rounds of "fuse what coincides, optimise again"."""
    places: PlaceSettings = DEFAULT_PLACE


DEFAULT_FUSION = FusionSettings()


@dataclass(frozen=True, slots=True, eq=False)
class _Fused:
    """One fused component, before all are put in one row."""

    pool: Pool
    joint: Joint
    xy: FloatArray
    places: list[Place]
    corridors: list[Corridor]
    poses: Mapping[str, FloatArray]


def fuse(
    maps: Sequence[TopoMap],
    verdicts: Sequence[PairVerdict],
    settings: FusionSettings = DEFAULT_FUSION,
    *,
    how_sure: bool = False,
) -> tuple[tuple[Component, ...], FusedMap]:
    """Components of runs joined by accepted verdicts, and the fused map of all of them.

    A component's frame is that of its first run by name. Positions come from one joint pose graph
    over all vertices of a component; vertices are fused from matched pairs, transitively, and
    where they coincide afterwards. Components, vertices and edges are numbered by run name and
    vertex: independent of the order of the input. A run that nothing matched is a component of
    its own, its map unchanged. how_sure: with the `spread` of every component.
    """
    by_name = {m.run: m for m in sorted(maps, key=lambda m: m.run)}
    accepted = [v for v in verdicts if v.accepted and v.a in by_name and v.b in by_name]
    fused = [
        _fuse_component([by_name[run] for run in runs], accepted, settings)
        for runs in components_of(by_name, accepted)
    ]
    components = tuple(
        Component(
            id=k,
            poses={run: f.poses[run] for run in sorted(f.poses)},
            spread=_spread(f) if how_sure else None,
        )
        for k, f in enumerate(fused)
    )
    return components, _assemble(fused)


def _spread(fused: _Fused) -> Spread | None:
    """How surely a component's runs are placed; None where it is one run."""
    joint = fused.joint
    if joint.graph is None or joint.solution is None:
        return None
    return spread(fused.pool, joint.graph, joint.solution)


def components_of(runs: Mapping[str, object], accepted: Sequence[PairVerdict]) -> list[list[str]]:
    """Runs connected by accepted verdicts, each list sorted, lists by their first runs."""
    joined = DisjointSet(runs)
    for v in accepted:
        joined.merge(v.a, v.b)
    return sorted(sorted(component) for component in joined.subsets())


def _fuse_component(
    maps: Sequence[TopoMap], accepted: Sequence[PairVerdict], settings: FusionSettings
) -> _Fused:
    pool = Pool.of(maps)
    inside = [v for v in accepted if v.a in pool.first and v.b in pool.first]
    groups = identify(pool, inside)
    start = run_poses(list(pool.first), inside)
    matched = [(v.a, v.b) for v in inside]
    joint = _settle(pool, groups, start, matched, settings)
    pose = joint.pose
    label = groups.labels()
    xy = _place_positions(pool, label, pose)
    places = fused_places(pool, label, pose, settings.places)
    branch_of = [np.zeros(0, np.int64)] * len(pool)
    for place in places:
        for row, mapping in place.branch_of.items():
            branch_of[row] = mapping
    corridors = corridors_of(pool, label, pose, xy, branch_of)
    if len(pool.maps) > 1:
        corridors = fuse_corridors(corridors, settings.corridors)
        headings = [p.headings for p in places]
        corridors = split_at_places(corridors, xy, headings, settings.passages, settings.corridors)
    return _Fused(pool, joint, xy, places, corridors, fitted_poses(pool, pose))


def _settle(
    pool: Pool,
    groups: Groups,
    start: Mapping[str, FloatArray],
    matched: Sequence[tuple[str, str]],
    settings: FusionSettings,
) -> Joint:
    """Optimise, fuse what coincides, and again until nothing more does."""
    joint = settle(pool, groups.labels(), start, settings.joint)
    if len(pool.maps) < 2:
        return joint
    for _ in range(settings.rounds):
        pairs = coincident(pool, groups, joint.pose, matched, settings.coincidence)
        joined = [groups.join(u, v) for u, v in pairs]
        if not any(joined):
            break
        joint = settle(pool, groups.labels(), start, settings.joint)
    return joint


def _place_positions(pool: Pool, label: IntArray, pose: FloatArray) -> FloatArray:
    """(places, 2) mean positions, weighted by passes."""
    weight = pass_counts(pool).astype(np.float64)
    total = np.bincount(label, weight)
    columns = [np.bincount(label, weight * pose[:, k]) / total for k in (0, 1)]
    return np.stack(columns, axis=-1)


# --- everything in one row ------------------------------------------------------------------------


def _assemble(parts: Sequence[_Fused]) -> FusedMap:
    """All components in one FusedMap, vertices numbered through."""
    offsets = np.concatenate([[0], np.cumsum([len(p.places) for p in parts])]).astype(np.int64)
    corridors = [
        (c, int(first)) for p, first in zip(parts, offsets, strict=False) for c in p.corridors
    ]
    places = [(p.pool, place) for p in parts for place in p.places]
    xy = [p.xy for p in parts if len(p.xy)]
    return FusedMap(
        component=np.repeat(np.arange(len(parts)), np.diff(offsets)),
        xy=np.concatenate(xy) if xy else np.zeros((0, 2)),
        branches=Ragged.from_rows(place.headings for _, place in places),
        kind=tuple(place.kind for _, place in places),
        members=tuple(_members(pool, place) for pool, place in places),
        observations=tuple(_observations(parts)),
        source=np.array([c.u + first for c, first in corridors], np.int64),
        target=np.array([c.v + first for c, first in corridors], np.int64),
        source_branch=np.array([c.branch_u for c, _ in corridors], np.int64),
        target_branch=np.array([c.branch_v for c, _ in corridors], np.int64),
        length=np.array([c.length for c, _ in corridors], np.float64),
        length_sigma=np.array([c.sigma for c, _ in corridors], np.float64),
        traversals=np.array([c.traversals for c, _ in corridors], np.int64),
        paths=tuple(c.path for c, _ in corridors),
        edge_members=tuple(c.members for c, _ in corridors),
    )


def _members(pool: Pool, place: Place) -> dict[str, tuple[int, ...]]:
    out: dict[str, tuple[int, ...]] = {}
    for row in place.rows:
        run = pool.maps[int(pool.run[row])].run
        out[run] = (*out.get(run, ()), int(pool.vertex[row]))
    return out


def _observations(parts: Sequence[_Fused]) -> list[tuple[tuple[str, int], ...]]:
    """For every place the passes of all its members, sorted."""
    out: list[tuple[tuple[str, int], ...]] = []
    for p in parts:
        place_of = np.empty(len(p.pool), np.int64)
        for k, place in enumerate(p.places):
            place_of[place.rows] = k
        seen: list[list[tuple[str, int]]] = [[] for _ in p.places]
        for m in p.pool.maps:
            rows = place_of[p.pool.first[m.run] + m.observation_vertex]
            for k, time_ns in zip(rows.tolist(), m.observation_time_ns.tolist(), strict=True):
                seen[k].append((m.run, time_ns))
        out += [tuple(sorted(s)) for s in seen]
    return out
