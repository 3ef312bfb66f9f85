"""Fusion of corridors of several runs between the same places.

§4: "estimates of path lengths can be updated by combining the measurements from the two maps", here
by inverse variance. Parallel corridors differ in their branches or their lengths and stay apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.corridor_lengths import LEAST_M, length_variances
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.passes import NO_BRANCH
from ...topology.polyline import way_of
from ...topology.ragged import parted
from ...topology.se2 import apply
from ...topology.topomap import TopoMap
from .vertex_partition import Pool

AGREE_SHARE = 0.05
"""Lengths that differ by this share of themselves agree, however exact they claim to be. Without it
a corridor of two runs stands twice in two of 34 merges."""


def allowed_m(length: float, sigma: float) -> float:
    """Largest difference of agreeing lengths [m]. length: of the shorter corridor; sigma: of the
    difference."""
    return max(AGREE_SHARE * length, LIKELIHOOD.gate_sigmas * sigma)


@dataclass(frozen=True, slots=True, eq=False)
class Corridor:
    """A corridor between two places, with ends in ascending order of (place, branch) and its path
    from u to v.

    sigma: of the length as in the run's map [m]; shared: its part that is common to all runs; way:
    its part that is independent of the ends and of the runs' scales. members: (run, edge) pairs,
    sorted. Branches are those of the fused places.
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
    shared: float
    way: float


def corridors_of(
    pool: Pool, label: IntArray, pose: FloatArray, place_xy: FloatArray, branch_of: list[IntArray]
) -> list[Corridor]:
    """Every corridor of every run, with its path between the fused places.

    branch_of: for each row of the pool, the fused branch of each of its branches.
    """
    corridors = []
    for m in pool.maps:
        first, shared = pool.first[m.run], 2**0.5 * m.measured.shared_centre_m
        rows = slice(first, first + len(m))
        place_of, branches = label[rows].tolist(), branch_of[rows]
        ways = [way_of(path) for path in m.paths]
        bent = _bent_paths(m, ways, pose[rows, 2], place_xy[label[rows]])
        columns = (
            *(m.source, m.target, m.source_branch, m.target_branch),
            *(m.length, m.length_sigma, m.traversals, np.sqrt(length_variances(m)[0])),
        )
        edges = zip(*(column.tolist() for column in columns), strict=True)
        for e, (s, t, i, j, length, sigma, traversals, way) in enumerate(edges):
            # The ends are fused over all runs: the length changes by as much as that of the path.
            stretch = float(way_of(bent[e])[-1] - ways[e][-1])
            corridor = Corridor(
                u=place_of[s],
                v=place_of[t],
                branch_u=int(branches[s][i]) if i != NO_BRANCH else NO_BRANCH,
                branch_v=int(branches[t][j]) if j != NO_BRANCH else NO_BRANCH,
                length=max(length + stretch, LEAST_M),
                sigma=sigma,
                traversals=traversals,
                path=bent[e],
                members=((m.run, e),),
                shared=min(shared, sigma),
                way=way,
            )
            corridors.append(oriented(corridor))
    return corridors


def _bent_paths(
    m: TopoMap, ways: Sequence[FloatArray], turn: FloatArray, place: FloatArray
) -> list[FloatArray]:
    """The paths of a run's map in the component's frame, bent so that they end at the fused places.

    A path is moved rigidly with its source and with its target, and interpolated between both in
    proportion to the distance. ways: `way_of` each path; turn: (n,) [rad] and place: (n, 2) [m], of
    the run's vertices in that frame.
    """
    if not m.paths:
        return []
    sizes = list(map(len, m.paths))
    flat, T = np.concatenate(m.paths), np.column_stack([place, turn])
    at_source, at_target = (
        apply(T[end], flat - m.xy[end]) for end in (m.source.repeat(sizes), m.target.repeat(sizes))
    )
    shares = [w / w[-1] if w[-1] > 0 else np.linspace(0, 1, len(w)) for w in ways]
    t = np.concatenate(shares)[:, None]
    return list(parted(np.asarray((1 - t) * at_source + t * at_target), sizes))


def oriented(c: Corridor) -> Corridor:
    """The corridor with its ends in ascending order."""
    if (c.u, c.branch_u) <= (c.v, c.branch_v):
        return c
    return replace(
        c, u=c.v, v=c.u, branch_u=c.branch_v, branch_v=c.branch_u, path=c.path[::-1].copy()
    )


def fuse_corridors(corridors: Iterable[Corridor]) -> list[Corridor]:
    """Fuse corridors between the same places that are one by `same_corridor`.

    Each joins the fitting bundle nearest in length, those with unknown branches last.
    """
    ordered = sorted(corridors, key=_order)
    bundles_of: dict[tuple[int, int], list[list[Corridor]]] = {}
    for c in ordered:
        bundles = bundles_of.setdefault((c.u, c.v), [])
        fitting = [b for b in bundles if same_corridor(b, c)]
        if fitting:
            min(fitting, key=lambda b: abs(_mean_length(b) - c.length)).append(c)
        else:
            bundles.append([c])
    fused = [_combined(b) for bundles in bundles_of.values() for b in bundles]
    return sorted(fused, key=_order)


def _order(c: Corridor) -> tuple[object, ...]:
    """Known branches first, then by ends, uncertainty and members."""
    unknown = (c.branch_u == NO_BRANCH) + (c.branch_v == NO_BRANCH)
    return (unknown, c.u, c.v, c.branch_u, c.branch_v, c.sigma, c.members)


def same_corridor(bundle: list[Corridor], c: Corridor) -> bool:
    """Whether a corridor between the same places belongs to a bundle, by branches and length.

    Only one corridor leaves by a branch, so that one equal branch is enough. If a branch is unknown
    at each end, only the length decides.
    """
    lead = bundle[0]
    ends = ((lead.branch_u, c.branch_u), (lead.branch_v, c.branch_v))
    known = [x == y for x, y in ends if NO_BRANCH not in (x, y)]
    if known and not any(known):
        return False
    x, y, sigma = _mean_length(bundle), c.length, float(np.hypot(lead.sigma, c.sigma))
    return abs(x - y) <= allowed_m(min(x, y), sigma)


def _weights(bundle: list[Corridor]) -> FloatArray:
    """(k,) inverse variances of the lengths [1/m²]."""
    return np.array([c.sigma for c in bundle]) ** -2.0


def _mean_length(bundle: list[Corridor]) -> float:
    """Mean length [m], weighted by inverse variance (§4)."""
    w = _weights(bundle)
    return float(w @ np.array([c.length for c in bundle]) / w.sum())


def _combined(bundle: list[Corridor]) -> Corridor:
    """One corridor of several: lengths by inverse variance (§4), the path of the least uncertain.

    The error common to all runs is not reduced: of its variance the weighted mean of independent
    errors already holds Σ w² (normalised weights w), the rest is added.
    """
    if len(bundle) == 1:
        return bundle[0]
    best = min(bundle, key=lambda c: (c.sigma, _order(c)))
    first_known = bundle[0]
    weight = _weights(bundle)
    square = (weight / weight.sum()) ** 2
    uncommon = max(1 - float(square.sum()), 0.0)
    shared = np.sqrt(uncommon) * min(c.shared for c in bundle)
    members = tuple(sorted({m for c in bundle for m in c.members}))
    return replace(
        best,
        branch_u=first_known.branch_u,
        branch_v=first_known.branch_v,
        length=_mean_length(bundle),
        sigma=float(np.hypot(weight.sum() ** -0.5, shared)),
        traversals=sum(c.traversals for c in bundle),
        members=members,
        way=float(np.sqrt(square @ np.array([c.way for c in bundle]) ** 2)),
    )
