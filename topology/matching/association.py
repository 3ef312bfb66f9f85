"""The association graph: the paper's hypothesis building (§2) as array operations.

A node of the graph is a vertex of a paired with a vertex of b under one correspondence of their
branches (§2.1); a link is a corridor of a paired with a corridor of b whose lengths agree and whose
ends are nodes (§2.2). Growing a match from any of its pairs reaches exactly one connected
component, so the components *are* the unique grown hypotheses, and one incompatible corridor or
vertex rejects its component. Links are found by binary search in sorted lengths; vertices that pair
without a common corridor are counted by class. Cost is linear in the compatible pairs and n log n
in the maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import take
from ..connected import connected
from ..ragged import rows_within
from .correspondence import (
    DEFAULT_GROWTH,
    GrowthSettings,
    Nodes,
    SlotClasses,
    candidate_nodes,
    correspond,
    decode,
    encode,
    is_rectilinear,
    masks_agree,
    node_codes,
    shared_branches,
)
from .structure import Structure


class Links(NamedTuple):
    """Compatible pairs of corridors, as darts (`structure.py`), and the nodes that they join.

    dart_a: (L,) darts of a, driven from source to target only; dart_b: (L,) darts of b; start, end:
    (L,) codes of their end nodes, as made by `correspondence.encode`.
    """

    dart_a: IntArray
    dart_b: IntArray
    start: IntArray
    end: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """All grown matches with a corridor, valid and rejected.

    nodes: N nodes in ascending order; component: (N,) the match of each; rejected: (C,) whether a
    match has an incompatibility; tested: (C,) number of corresponding branches driven in both maps;
    agreed: (C,) number of these with a link; links; link_component: (L,) the match of each link;
    rectilinear: whether correspondences are quarter turns.
    """

    nodes: Nodes
    component: IntArray
    rejected: BoolArray
    tested: IntArray
    agreed: IntArray
    links: Links
    link_component: IntArray
    rectilinear: bool


def grow(
    a: Structure,
    b: Structure,
    settings: GrowthSettings = DEFAULT_GROWTH,
    seeds: Nodes | None = None,
) -> Growth:
    """Grow all matches between two maps (§2.2), or those from `seeds` only (§4.2): growing from any
    node of a match gives all of it.

    O((m_a + m_b) log m_b + L log L) with L the compatible pairs of corridors. Deterministic.
    """
    links = _find_links(a, b, settings)
    if seeds is not None:
        links = _connected_to(links, node_codes(a, b, seeds, is_rectilinear(a, b, settings)))
    return _components(a, b, links, settings)


def _connected_to(links: Links, seeds: IntArray) -> Links:
    """The links connected, through links, to one of the nodes with the codes `seeds`."""
    size = len(links.start)
    code, inverse = np.unique(np.concatenate([links.start, links.end]), return_inverse=True)
    component = connected(inverse[:size], inverse[size:], len(code))
    reached = np.isin(component[inverse[:size]], component[np.isin(code, seeds)])
    return Links(*(column[reached] for column in links))


# --- links: compatible pairs of corridors ---------------------------------------------------------


def _find_links(a: Structure, b: Structure, settings: GrowthSettings) -> Links:
    """Pairs of corridors that agree in length and in the vertices at both ends."""
    rectilinear = is_rectilinear(a, b, settings)
    rows_a = np.arange(0, len(a.start), 2)
    rows_b = np.arange(len(b.start))
    if len(rows_a) == 0 or len(rows_b) == 0:
        none = np.zeros(0, np.int64)
        return Links(none, none, none, none)
    i, j = _equal_lengths(
        _Measured(_dart_kind(a, rows_a, settings, rectilinear), a.length[rows_a], a.sigma[rows_a]),
        _Measured(_dart_kind(b, rows_b, settings, rectilinear), b.length[rows_b], b.sigma[rows_b]),
        _search_bound(a, b, settings),
    )
    nodes = _slot_nodes if rectilinear else _angle_nodes
    return nodes(a, b, rows_a[i], rows_b[j], settings)


def _search_bound(a: Structure, b: Structure, settings: GrowthSettings) -> float:
    """Largest difference of two lengths for which corridors are compared, in standard deviations.

    That of the largest possible match, all corridors of the smaller map. The count is rounded up to
    a power of two, so that the bound rarely changes while maps grow.
    """
    most = max(1, min(len(a.start), len(b.start)) // 2)
    return settings.bound_sigmas(1 << (most - 1).bit_length())


def _dart_kind(
    s: Structure, darts: IntArray, settings: GrowthSettings, rectilinear: bool
) -> FloatArray:
    """(k,) key that two darts must have in common to be compared.

    Rectilinear: the turn between leaving and arriving and, if degrees are exact, the slots at both
    ends; otherwise the degrees of both ends, if exact.
    """
    if rectilinear:
        kind = s.slot_kind[darts]
        return np.asarray(kind if settings.degree == "exact" else kind // 256, np.float64)
    if settings.degree == "inexact":
        return np.zeros(len(darts))
    return (s.degree[s.start[darts]] * 64 + s.degree[s.end[darts]]).astype(np.float64)


class _Measured(NamedTuple):
    """Corridors to compare: `kind` must be equal, `length` [m] close in terms of `sigma` [m]."""

    kind: FloatArray
    length: FloatArray
    sigma: FloatArray


def _equal_lengths(x: _Measured, y: _Measured, bound_sigmas: float) -> tuple[IntArray, IntArray]:
    """Index pairs of equal kind whose lengths differ by at most the bound of their difference.

    Strategy: binary search for windows in lengths sorted within their kind. The less certain of
    the two sets the width of the window, so pairs are sought once from x (where x is the less
    certain) and once from y.
    """
    span = 2 * (max(x.length.max(), y.length.max()) + 1.0)
    key_x, key_y = x.kind * span + x.length, y.kind * span + y.length
    reach = bound_sigmas * np.sqrt(2.0)
    cap = span / 2 - 0.5  # a window never reaches the next kind
    i, j = rows_within(key_x, key_y, np.minimum(reach * x.sigma, cap))
    k, h = rows_within(key_y, key_x, np.minimum(reach * y.sigma, cap))
    wide_x, wide_y = x.sigma[i] >= y.sigma[j], y.sigma[k] > x.sigma[h]
    i = np.concatenate([i[wide_x], h[wide_y]])
    j = np.concatenate([j[wide_x], k[wide_y]])
    close = np.abs(x.length[i] - y.length[j]) <= bound_sigmas * np.hypot(x.sigma[i], y.sigma[j])
    return i[close], j[close]


def _slot_nodes(
    a: Structure, b: Structure, dart_a: IntArray, dart_b: IntArray, settings: GrowthSettings
) -> Links:
    """Rectilinear world: a node is (vertex of a, vertex of b, quarter turns of b).

    Exact degrees: the darts' signatures have already compared the vertices.
    """
    turn = (a.out_slot[dart_a] - b.out_slot[dart_b]) % 4
    if settings.degree == "inexact":
        compatible = masks_agree(a.mask[a.start[dart_a]], b.mask[b.start[dart_b]], turn, settings)
        compatible &= masks_agree(a.mask[a.end[dart_a]], b.mask[b.end[dart_b]], turn, settings)
        dart_a, dart_b, turn = dart_a[compatible], dart_b[compatible], turn[compatible]
    start = (a.start[dart_a] * len(b) + b.start[dart_b]) * 4 + turn
    end = (a.end[dart_a] * len(b) + b.end[dart_b]) * 4 + turn
    return Links(dart_a, dart_b, start, end)


def _angle_nodes(
    a: Structure, b: Structure, dart_a: IntArray, dart_b: IntArray, settings: GrowthSettings
) -> Links:
    """General world: a node is (vertex of a, vertex of b, partner of each branch of a)."""
    leave = (a.start[dart_a], a.out_branch[dart_a]), (b.start[dart_b], b.out_branch[dart_b])
    arrive = (a.end[dart_a], a.in_branch[dart_a]), (b.end[dart_b], b.in_branch[dart_b])
    ok_start, partner_start = correspond(a, b, *leave, settings)
    ok_end, partner_end = correspond(a, b, *arrive, settings)
    compatible = ok_start & ok_end
    dart_a, dart_b = dart_a[compatible], dart_b[compatible]
    start = encode(a, b, a.start[dart_a], b.start[dart_b], partner_start[compatible])
    end = encode(a, b, a.end[dart_a], b.end[dart_b], partner_end[compatible])
    return Links(dart_a, dart_b, start, end)


# --- components: the grown matches ----------------------------------------------------------------


def _components(a: Structure, b: Structure, links: Links, settings: GrowthSettings) -> Growth:
    """The connected components of the links, rejecting those with an incompatibility (§2.2)."""
    rectilinear = is_rectilinear(a, b, settings)
    size = len(links.start)
    code, inverse = np.unique(np.concatenate([links.start, links.end]), return_inverse=True)
    nodes = decode(a, b, code, rectilinear)
    component = connected(inverse[:size], inverse[size:], len(code))
    count = int(component.max(initial=-1)) + 1
    # A branch driven in both maps whose corridors do not pair is an incompatibility.
    satisfied = _tested_branches(a, links, inverse, rectilinear)
    shared = shared_branches(a, b, nodes, rectilinear)
    rejected = np.zeros(count, np.bool_)
    rejected[component[satisfied < shared]] = True
    link_component = component[inverse[:size]]
    rejected[_out_of_bounds(a, b, links, link_component, settings)] = True
    rejected[_not_one_to_one(nodes, component, rejected)] = True
    return Growth(
        nodes=nodes,
        component=component,
        rejected=rejected,
        tested=np.bincount(component, shared, count).astype(np.int64),
        agreed=np.bincount(component, satisfied, count).astype(np.int64),
        links=links,
        link_component=link_component,
        rectilinear=rectilinear,
    )


def _out_of_bounds(
    a: Structure, b: Structure, links: Links, component: IntArray, settings: GrowthSettings
) -> IntArray:
    """Matches with a length difference beyond the bound for their number of corridors.

    Links are searched within the bound of the largest match. A link between the two bounds would be
    an incompatibility at both of its ends, so its match is rejected either way.
    """
    corridors_of_match = np.bincount(component)
    sigma = np.hypot(a.sigma[links.dart_a], b.sigma[links.dart_b])
    difference = np.abs(a.length[links.dart_a] - b.length[links.dart_b])
    bound = np.zeros(int(corridors_of_match.max(initial=0)) + 1)
    for corridors in np.flatnonzero(np.bincount(corridors_of_match)).tolist():
        bound[corridors] = settings.bound_sigmas(corridors)
    return component[difference > bound[corridors_of_match[component]] * sigma]


def _tested_branches(a: Structure, links: Links, node: IntArray, rectilinear: bool) -> IntArray:
    """(N,) corresponding branches of each node along which a pair of corridors was found.

    node: (2 L,) the start nodes of all links, then their end nodes.
    """
    count = int(node.max(initial=-1)) + 1
    leaving, arriving = (a.out_slot, a.in_slot) if rectilinear else (a.out_branch, a.in_branch)
    branch = np.concatenate([leaving[links.dart_a], arriving[links.dart_a]])
    width = int(branch.max(initial=0)) + 1
    return np.bincount(np.unique(node * width + branch) // width, minlength=count)


def _not_one_to_one(nodes: Nodes, component: IntArray, rejected: BoolArray) -> IntArray:
    """Matches not yet rejected that pair a vertex twice."""
    valid = ~rejected[component]
    found = []
    for vertex in (nodes.vertex_a, nodes.vertex_b):
        key = component[valid] * (int(vertex.max(initial=0)) + 1) + vertex[valid]
        order = np.argsort(key, kind="stable")
        repeated = key[order][1:] == key[order][:-1]
        found.append(component[valid][order][1:][repeated])
    return np.concatenate(found)


# --- pairs of vertices that no corridor tests -----------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class SingleMatches:
    """Compatible nodes outside all grown matches that nothing contradicts (H1 of §2.3).

    candidates: number of all compatible nodes, whether grown, single, or rejected by their first
    corridor.
    """

    nodes: Nodes
    candidates: int


def single_matches(
    a: Structure, b: Structure, growth: Growth, settings: GrowthSettings = DEFAULT_GROWTH
) -> SingleMatches:
    """Pairs of compatible vertices that have no driven branch in common (§2.3).

    Such a pair cannot be grown, so it is a hypothesis of one vertex. Rectilinear: classes of
    vertices by their branch slots are compared, not vertices; general: all pairs.
    """
    if growth.rectilinear:
        return _slot_singles(a, b, settings)
    nodes = candidate_nodes(a, b, settings)
    return SingleMatches(take(nodes, shared_branches(a, b, nodes, False) == 0), len(nodes))


def _slot_singles(a: Structure, b: Structure, settings: GrowthSettings) -> SingleMatches:
    """`single_matches` of rectilinear maps, by classes of vertices with equal slots."""
    classes = SlotClasses.of(a, b, settings)
    return SingleMatches(
        nodes=classes.expanded(classes.compatible & classes.disjoint),
        candidates=int((classes.compatible.sum(axis=2) * classes.sizes).sum()),
    )
