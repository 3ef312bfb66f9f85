"""A fused component and its serialisation to bytes.

Reading returns the same values to the last bit. Bytes are validated against the maps, so that no
input makes a component with indices outside of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.passes import NO_BRANCH
from ...topology.ragged import Ragged, parted
from ...topology.topomap import TopoMap
from ..packs import arrays_from_bytes, arrays_to_bytes
from ..result import FusedMap, Late, Spread, by_run

Rows = tuple[tuple[tuple[str, int], ...], ...]

ARRAYS = "fffiffiifiiiiiiiffiiff"
"""Types of the arrays: poses; centroids, own covariances, keys and cross covariances of the spread
(empty if not computed); positions, kinds and degrees of the vertices; the branches; members of the
vertices as counts, runs and rows; the same of the edges; their ends and branches, lengths, sigmas
and traversals; point counts of their paths; the points; sigmas of the positions (empty if not
computed)."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedComponent:
    """One component: T_component_run of every run, its part of the fused map (numbered from 0), and
    the covariances of the runs' placements, if computed; text: as in `Component`."""

    poses: Mapping[str, FloatArray]
    fused: FusedMap
    spread: Spread | None = None
    text: bytes = b""


def observations_of(
    maps: Sequence[TopoMap], members: Sequence[Mapping[str, tuple[int, ...]]]
) -> Rows:
    """For every place the passes of all its members as (run, time), sorted."""
    place_of = {m.run: np.zeros(len(m), np.int64) for m in maps}
    for k, own in enumerate(members):
        for run, vertices in own.items():
            place_of[run][list(vertices)] = k
    seen: list[list[tuple[str, int]]] = [[] for _ in members]
    for m in maps:
        rows = place_of[m.run][m.observation_vertex].tolist()
        for k, time_ns in zip(rows, m.observation_time_ns.tolist(), strict=True):
            seen[k].append((m.run, time_ns))
    return tuple(tuple(sorted(s)) for s in seen)


def to_bytes(component: FusedComponent, maps: Sequence[TopoMap]) -> bytes:
    """Serialise a component. maps: its runs' maps, sorted by run."""
    fused, sure = component.fused, component.spread
    kinds = {kind: k for k, kind in enumerate(_kinds(maps))}
    behind = [[(run, v) for run, own in of.items() for v in own] for of in fused.members]
    return arrays_to_bytes(
        [
            np.array([component.poses[m.run] for m in maps], np.float64),
            np.zeros(0) if sure is None else sure.middle,
            np.zeros(0) if sure is None else sure.own,
            np.zeros(0, np.int64) if sure is None else sure.key,
            np.zeros(0) if sure is None else sure.cross,
            fused.xy,
            np.array([kinds[kind] for kind in fused.kind], np.int64),
            fused.branches.counts,
            fused.branches.values,
            *_flat(behind, maps),
            *_flat(fused.edge_members, maps),
            np.stack([fused.source, fused.target, fused.source_branch, fused.target_branch]),
            fused.length,
            fused.length_sigma,
            fused.traversals,
            np.array([len(path) for path in fused.paths], np.int64),
            np.concatenate([np.zeros((0, 2)), *fused.paths]),
            np.zeros(0) if fused.position_sigma is None else fused.position_sigma,
        ]
    )


def from_bytes(data: bytes, maps: Sequence[TopoMap]) -> FusedComponent | None:
    """The component of the maps, sorted by run; None if the data cannot be theirs."""
    arrays = arrays_from_bytes(data, ARRAYS)
    if arrays is None:
        return None
    poses, middle, own, key, cross, xy, kind, degree, branches, *arrays = arrays
    places, corridors, (ends, length, sigma, traversals, steps, points, off) = (
        arrays[:3], arrays[3:6], arrays[6:],
    )  # fmt: skip
    if not all(((x >= low) & (x <= len(data))).all() for x, low in ((degree, 0), (steps, 2))):
        return None
    r, n, m, sure = len(maps), len(degree), len(length), len(middle) > 0
    sizes = (
        (poses, 3 * r), (middle, 2 * r * sure), (own, 9 * r * sure),
        (cross, 9 * len(key) * sure), (xy, 2 * n),
        (kind, n), (places[0], n), (corridors[0], m), (ends, 4 * m), (sigma, m), (traversals, m),
        (steps, m), (points, 2 * steps.sum()), (branches, degree.sum()),
        (off, n * (len(off) > 0)),
    )  # fmt: skip
    if any(len(array) != size for array, size in sizes):
        return None
    source, target, *leave = ends.reshape(4, m)
    kinds, vertices, edges = _kinds(maps), [len(x) for x in maps], [len(x.source) for x in maps]
    bounds = (
        (kind, 0, len(kinds)), (traversals, 0, np.inf),
        (source, 0, n), (target, 0, n), (leave[0], NO_BRANCH, degree[source % max(n, 1)]),
        (leave[1], NO_BRANCH, degree[target % max(n, 1)]),
        (key, 0, r * r), (np.diff(key), 1, np.inf),
    )  # fmt: skip
    if not all(((low <= x) & (x < high)).all() for x, low, high in bounds):
        return None
    if not (_are_rows(places, vertices) and _are_rows(corridors, edges)) or (
        len(places[1]) != sum(vertices)
    ):
        return None
    members = Late(n, lambda: tuple(by_run(own) for own in _rows(places, maps)))
    runs = tuple(x.run for x in maps)
    fused = FusedMap(
        component=np.zeros(n, np.int64),
        xy=xy.reshape(-1, 2),
        branches=Ragged(np.cumsum([0, *degree]), branches),
        kind=tuple(kinds[k] for k in kind.tolist()),
        members=members,
        observations=Late(n, lambda: observations_of(maps, members)),
        source=source,
        target=target,
        source_branch=leave[0],
        target_branch=leave[1],
        length=length,
        length_sigma=sigma,
        traversals=traversals,
        paths=parted(points.reshape(-1, 2), steps.tolist()),
        edge_members=Late(m, lambda: _rows(corridors, maps)),
        position_sigma=off if len(off) else None,
    )
    spread = None
    if sure:
        blocks = (own.reshape(-1, 3, 3), key, cross.reshape(-1, 3, 3))
        spread = Spread(runs, middle.reshape(-1, 2), *blocks)
    return FusedComponent(dict(zip(runs, poses.reshape(-1, 3), strict=True)), fused, spread)


def _kinds(maps: Sequence[TopoMap]) -> list[str]:
    return sorted({kind for m in maps for kind in m.kind})


def _flat(rows: Iterable[Sequence[tuple[str, int]]], maps: Sequence[TopoMap]) -> list[IntArray]:
    """Rows of (run, number) as their sizes, run indices and numbers, concatenated."""
    of = {m.run: k for k, m in enumerate(maps)}
    listed = list(rows)
    flat = np.array([(of[run], k) for row in listed for run, k in row], np.int64).reshape(-1, 2)
    return [np.array([len(row) for row in listed], np.int64), flat[:, 0], flat[:, 1]]


def _are_rows(flat: Sequence[IntArray], most: Sequence[int]) -> bool:
    """Whether flat rows are valid; most: for each run the number of its items."""
    size, run, number = flat
    if len(run) != len(number) or ((size < 0) | (size > len(run))).any() or size.sum() != len(run):
        return False
    if ((run < 0) | (run >= len(most)) | (number < 0)).any():
        return False
    return bool((number < np.array(most)[run]).all())


def _rows(flat: Sequence[IntArray], maps: Sequence[TopoMap]) -> Rows:
    """The inverse of `_flat`."""
    size, run, number = flat
    names = [m.run for m in maps]
    pairs = [(names[r], k) for r, k in zip(run.tolist(), number.tolist(), strict=True)]
    stops = np.cumsum([0, *size.tolist()]).tolist()
    return tuple(tuple(pairs[i:j]) for i, j in pairwise(stops))
