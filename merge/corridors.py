"""Corridors of several runs that are one: fused where they join the same places the same way.

§4: "estimates of path lengths can be updated by combining the measurements from the two maps";
here by inverse variance. Parallel corridors differ in their branches or their lengths and stay
apart; a corridor that runs past a junction known from another run is replaced by its parts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..topology.passes import NO_BRANCH
from ..topology.se2 import apply, wrap
from .identity import Pool

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CorridorSettings:
    """When corridors agree, and when one passes through a junction it did not see."""

    agree_sigmas: float = 4.0
    """Lengths agree within so many sigmas of their difference …"""
    agree_m: float = 0.4
    """… or within this …"""
    agree_share: float = 0.05
    """… plus this share of the length."""
    pass_m: float = 0.8
    """A corridor passes through a junction that is no further from its path than this …"""
    pass_end_m: float = 1.2
    """… and at least this far from both of its ends along the path …"""
    pass_rad: float = 0.6
    """… and has branches along the path both ways within this angle."""


DEFAULT_CORRIDOR = CorridorSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Corridor:
    """A corridor between two places: ends in ascending (place, branch), path from u to v.

    members: (run, edge) pairs, sorted. Branches are those of the fused places.
    """

    u: int
    v: int
    branch_u: int
    branch_v: int
    length: float
    sigma: float
    traversals: int
    path: FloatArray
    members: tuple[tuple[str, int], ...]


def corridors_of(
    pool: Pool, label: IntArray, pose: FloatArray, place_xy: FloatArray, branch_of: list[IntArray]
) -> list[Corridor]:
    """Every corridor of every run, drawn between the fused places.

    branch_of: for each row of the pool, the fused branch of each of its branches.
    """
    out = []
    for m in pool.maps:
        first = pool.first[m.run]
        for e in range(len(m.source)):
            s, t = first + int(m.source[e]), first + int(m.target[e])
            i, j = int(m.source_branch[e]), int(m.target_branch[e])
            branch_s = int(branch_of[s][i]) if i != NO_BRANCH else NO_BRANCH
            branch_t = int(branch_of[t][j]) if j != NO_BRANCH else NO_BRANCH
            ends = (m.xy[m.source[e]], m.xy[m.target[e]])
            path = _drawn(m.paths[e], ends, pose[[s, t]], place_xy[label[[s, t]]])
            corridor = Corridor(
                u=int(label[s]),
                v=int(label[t]),
                branch_u=branch_s,
                branch_v=branch_t,
                length=float(m.length[e]),
                sigma=float(m.length_sigma[e]),
                traversals=int(m.traversals[e]),
                path=path,
                members=((m.run, e),),
            )
            out.append(_oriented(corridor))
    return out


def _drawn(
    path: FloatArray, ends: tuple[FloatArray, FloatArray], pose: FloatArray, place: FloatArray
) -> FloatArray:
    """A path of a run's map in the component's frame, its ends on the fused places.

    Both ends carry the path along rigidly; in between they hand over in proportion to the way.
    """
    steps = np.hypot(*np.diff(path, axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    t = (way / way[-1] if way[-1] > 0 else np.linspace(0, 1, len(path)))[:, None]
    turned = [
        apply(np.array([place[k, 0], place[k, 1], pose[k, 2]]), path - ends[k]) for k in (0, 1)
    ]
    return np.asarray((1 - t) * turned[0] + t * turned[1])


def _oriented(c: Corridor) -> Corridor:
    """The corridor with its ends in ascending order."""
    if (c.u, c.branch_u) <= (c.v, c.branch_v):
        return c
    return replace(
        c, u=c.v, v=c.u, branch_u=c.branch_v, branch_v=c.branch_u, path=c.path[::-1].copy()
    )


def fuse_corridors(
    corridors: Iterable[Corridor], settings: CorridorSettings = DEFAULT_CORRIDOR
) -> list[Corridor]:
    """Corridors that join the same places by the same branches and agree in length made one.

    A corridor of which a branch is unknown joins the nearest in length that fits what is known.
    """
    known = sorted(corridors, key=_order)
    out: dict[tuple[int, int], list[list[Corridor]]] = {}
    for c in known:
        bundles = out.setdefault((c.u, c.v), [])
        fitting = [b for b in bundles if _same_corridor(b, c, settings)]
        if fitting:
            min(fitting, key=lambda b: abs(_mean_length(b) - c.length)).append(c)
        else:
            bundles.append([c])
    fused = [_combined(b) for bundles in out.values() for b in bundles]
    return sorted(fused, key=_order)


def _order(c: Corridor) -> tuple[object, ...]:
    """Known branches first, then by ends, certainty and provenance."""
    unknown = (c.branch_u == NO_BRANCH) + (c.branch_v == NO_BRANCH)
    return (unknown, c.u, c.v, c.branch_u, c.branch_v, c.sigma, c.members)


def _same_corridor(bundle: list[Corridor], c: Corridor, settings: CorridorSettings) -> bool:
    lead = bundle[0]
    for ours, theirs in ((lead.branch_u, c.branch_u), (lead.branch_v, c.branch_v)):
        if ours != theirs and NO_BRANCH not in (ours, theirs):
            return False
    return _agree(_mean_length(bundle), lead.sigma, c.length, c.sigma, settings)


def _agree(x: float, sigma_x: float, y: float, sigma_y: float, settings: CorridorSettings) -> bool:
    allowed = settings.agree_m + settings.agree_share * min(x, y)
    return abs(x - y) <= max(allowed, settings.agree_sigmas * float(np.hypot(sigma_x, sigma_y)))


def _weights(bundle: list[Corridor]) -> FloatArray:
    return np.array([c.sigma for c in bundle]) ** -2.0


def _mean_length(bundle: list[Corridor]) -> float:
    w = _weights(bundle)
    return float(w @ np.array([c.length for c in bundle]) / w.sum())


def _combined(bundle: list[Corridor]) -> Corridor:
    """One corridor of several: lengths by inverse variance (§4), path of the best measured."""
    if len(bundle) == 1:
        return bundle[0]
    best = min(bundle, key=lambda c: (c.sigma, _order(c)))
    lead = bundle[0]
    members = tuple(sorted({m for c in bundle for m in c.members}))
    return replace(
        best,
        branch_u=lead.branch_u,
        branch_v=lead.branch_v,
        length=_mean_length(bundle),
        sigma=float(_weights(bundle).sum() ** -0.5),
        traversals=sum(c.traversals for c in bundle),
        members=members,
    )


# --- corridors past a junction that another run knows ---------------------------------------------


def split_at_places(
    corridors: list[Corridor],
    place_xy: FloatArray,
    branches: list[FloatArray],
    settings: CorridorSettings = DEFAULT_CORRIDOR,
) -> list[Corridor]:
    """Replace corridors that run through known places by the corridors between those.

    A part that is known already takes the long corridor in as a member; a part that no run drove
    from junction to junction becomes a corridor of its own. Where no part is known, or a place
    has no branches along the path, the corridor stays whole.
    """
    tree = cKDTree(place_xy)
    taken: list[Corridor] = []
    extra: dict[int, list[Corridor]] = {}
    fresh: list[Corridor] = []
    index = _by_ends(corridors)
    for number, c in enumerate(corridors):
        parts = _parts(c, tree, place_xy, branches, settings)
        found = [_known_part(p, number, corridors, index, settings) for p in parts]
        if len(parts) < 2 or all(f is None for f in found):
            continue
        taken.append(c)
        for part, k in zip(parts, found, strict=True):
            if k is None:
                fresh.append(_oriented(part))
            else:
                extra.setdefault(k, []).append(part)
    gone = {id(c) for c in taken}
    kept = [_with_extra(c, extra.get(k, [])) for k, c in enumerate(corridors) if id(c) not in gone]
    # A part may have been found in a corridor that is itself replaced: its own parts carry on.
    return fuse_corridors([*kept, *fresh], settings)


def _by_ends(corridors: list[Corridor]) -> dict[tuple[int, int], list[int]]:
    index: dict[tuple[int, int], list[int]] = {}
    for k, c in enumerate(corridors):
        index.setdefault((c.u, c.v), []).append(k)
    return index


def _with_extra(c: Corridor, parts: list[Corridor]) -> Corridor:
    if not parts:
        return c
    members = tuple(sorted({*c.members, *(m for p in parts for m in p.members)}))
    return replace(c, traversals=c.traversals + sum(p.traversals for p in parts), members=members)


def _known_part(
    part: Corridor,
    number: int,
    corridors: list[Corridor],
    index: dict[tuple[int, int], list[int]],
    settings: CorridorSettings,
) -> int | None:
    """The corridor that is already known between the ends of a part, by the same branches."""
    p = _oriented(part)
    for k in index.get((p.u, p.v), []):
        if k != number and _same_corridor([corridors[k]], p, settings):
            return k
    return None


def _parts(
    c: Corridor,
    tree: Any,
    place_xy: FloatArray,
    branches: list[FloatArray],
    settings: CorridorSettings,
) -> list[Corridor]:
    """The corridor cut at the places it runs through; itself alone if there are none."""
    steps = np.hypot(*np.diff(c.path, axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    if way[-1] < 2 * settings.pass_end_m:
        return [c]
    fine = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / 0.25)) + 1))
    points = np.column_stack([np.interp(fine, way, c.path[:, k]) for k in (0, 1)])
    near = {k for hits in tree.query_ball_point(points, settings.pass_m) for k in hits}
    cuts = []
    for place in sorted(near - {c.u, c.v}):
        at = int(np.argmin(np.hypot(*(points - place_xy[place]).T)))
        if settings.pass_end_m <= fine[at] <= way[-1] - settings.pass_end_m:
            back, on = _along(points, at, branches[place], settings)
            if back is not None and on is not None and back != on:
                cuts.append((float(fine[at]), place, back, on, at))
    if not cuts:
        return [c]
    return _cut(c, sorted(cuts), points, float(way[-1]))


def _along(
    points: FloatArray, at: int, headings: FloatArray, settings: CorridorSettings
) -> tuple[int | None, int | None]:
    """The branches of a place by which a path through it comes in and goes on."""
    if len(headings) == 0:
        return None, None
    low, high = max(at - 4, 0), min(at + 4, len(points) - 1)
    out = []
    for other in (low, high):
        step = points[other] - points[at]
        off = np.abs(wrap(headings - np.arctan2(step[1], step[0])))
        best = int(off.argmin())
        out.append(best if off[best] <= settings.pass_rad else None)
    return out[0], out[1]


def _cut(
    c: Corridor,
    cuts: list[tuple[float, int, int, int, int]],
    points: FloatArray,
    drawn_length: float,
) -> list[Corridor]:
    """The corridor in parts, each from one place to the next; lengths in proportion to the path."""
    scale = c.length / drawn_length
    stops = [(0.0, c.u, NO_BRANCH, c.branch_u, 0), *cuts]
    stops.append((drawn_length, c.v, c.branch_v, NO_BRANCH, len(points) - 1))
    parts = []
    for (s0, u, _, out, i), (s1, v, into, _, j) in pairwise(stops):
        share = (s1 - s0) / drawn_length
        parts.append(
            replace(
                c,
                u=u,
                v=v,
                branch_u=out,
                branch_v=into,
                length=max((s1 - s0) * scale, 1e-3),
                sigma=float(np.hypot(c.sigma * np.sqrt(share), 0.1)),
                path=points[i : j + 1].copy() if j > i else points[[i, min(i + 1, j)]].copy(),
            )
        )
    return parts
