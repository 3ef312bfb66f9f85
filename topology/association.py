"""The association graph: all of the paper's hypothesis building (§2) as array operations.

A node of the graph is a vertex of a paired with a vertex of b under one correspondence of their
branches (§2.1); a link is a corridor of a paired with a corridor of b such that lengths agree and
both ends are nodes (§2.2). Growing a match from any of its pairs reaches exactly one connected
component, so the components *are* the unique grown hypotheses, and one incompatible corridor or
vertex rejects the component. Links are found by binary search in sorted lengths, the vertices
that pair without any corridor in common are counted by class: nothing is quadratic in the maps
but what is compatible.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .se2 import wrap
from .structure import FloatArray, IntArray, Structure

World = Literal["auto", "rectilinear", "general"]

QUARTER = np.pi / 2
POPCOUNT = np.array([bin(m).count("1") for m in range(16)], np.int64)
TURNED = np.array([[((m << r) | (m >> (4 - r))) & 15 for r in range(4)] for m in range(16)])
"""TURNED[mask, r]: the slots of `mask` turned by r quarter turns."""


@dataclass(frozen=True, slots=True)
class GrowthSettings:
    """When vertices and corridors are compatible (§2.1, §2.2, §2.3)."""

    world: World = "auto"
    """rectilinear: branch directions are exact up to the four rotations (§2.3); general: they are
    compared with a similarity test; auto: rectilinear if both maps are."""
    degree: Literal["exact", "inexact"] = "exact"
    """exact: a static world; inexact: doors open and close (§2.1)."""
    unmatched_branches: int = 1
    """Inexact degree: branches that either vertex of a pair may have and the other not."""
    branch_tolerance_rad: float = 0.35
    """General world: how far a branch may be from its partner under the pair's rotation."""
    length_bound_sigmas: float = 1.96
    """Corridors agree if their lengths differ by no more than this bound (95 %, §5) of the
    difference of two measurements."""


DEFAULT_GROWTH = GrowthSettings()

Ends = tuple[IntArray, IntArray]
"""Vertices (k,) and, at each, the branch by which a dart leaves or arrives (k,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Vertices of a paired with vertices of b under a correspondence of their branches.

    vertex_a, vertex_b: (N,); correspondence: (N,) quarter turns of b (rectilinear worlds) or the
    partners of a's branches as one number (general worlds, see `partners`).
    """

    vertex_a: IntArray
    vertex_b: IntArray
    correspondence: IntArray

    def __len__(self) -> int:
        return len(self.vertex_a)

    def take(self, rows: IntArray | NDArray[np.bool_]) -> Nodes:
        """The given rows."""
        return Nodes(self.vertex_a[rows], self.vertex_b[rows], self.correspondence[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Compatible pairs of corridors: darts of a (forward ones only) and of b, and their end nodes.

    dart_a, dart_b: (L,); start, end: (L,) codes of the nodes they join; codes and what they mean
    depend on the world and the two maps alone.
    """

    dart_a: IntArray
    dart_b: IntArray
    start: IntArray
    end: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """All grown matches that hold a corridor, valid and rejected.

    nodes: N nodes in ascending order; component: (N,) the match of each; rejected: (C,) True where
    a match ran into an incompatibility; links, with the match of each in link_component (L,);
    rectilinear: which world the correspondences are of.
    """

    nodes: Nodes
    component: IntArray
    rejected: NDArray[np.bool_]
    links: Links
    link_component: IntArray
    rectilinear: bool


def is_rectilinear(a: Structure, b: Structure, settings: GrowthSettings) -> bool:
    """Whether a and b are matched with exact orientations (§2.3)."""
    return settings.world != "general" and a.grid_rad is not None and b.grid_rad is not None


def grow(a: Structure, b: Structure, settings: GrowthSettings = DEFAULT_GROWTH) -> Growth:
    """Grow all matches between two maps (§2.2).

    O((m_a + m_b) log m_b + L log L) with L the compatible pairs of corridors. Deterministic.
    """
    return assemble(a, b, find_links(a, b, settings), settings)


def grow_split(
    a: Structure,
    b: Structure,
    settings: GrowthSettings,
    executor: Executor,
    parts: int,
) -> Growth:
    """`grow` with the search for links split over workers (§4.2: "can easily be split").

    Every worker gets a share of a's corridors; the components are put together here.
    """
    forward = np.arange(0, len(a.start), 2)
    shares = [forward[k::parts] for k in range(parts)]
    jobs = [executor.submit(find_links, a, b, settings, share) for share in shares]
    return assemble(a, b, join_links([job.result() for job in jobs]), settings)


# --- links: compatible pairs of corridors ---------------------------------------------------------


def find_links(
    a: Structure,
    b: Structure,
    settings: GrowthSettings = DEFAULT_GROWTH,
    darts_a: IntArray | None = None,
    darts_b: IntArray | None = None,
) -> Links:
    """Pairs of corridors that agree in length and in the vertices at both ends.

    darts_a, darts_b restrict the search to some forward darts of a and some darts of b: parts
    found apart (on several workers, or old and new ones) are joined by `join_links`.
    """
    rectilinear = is_rectilinear(a, b, settings)
    rows_a = np.arange(0, len(a.start), 2) if darts_a is None else darts_a
    rows_b = np.arange(len(b.start)) if darts_b is None else darts_b
    if len(rows_a) == 0 or len(rows_b) == 0:
        none = np.zeros(0, np.int64)
        return Links(none, none, none, none)
    signature = _slot_signature if rectilinear else _degree_signature
    i, j = _equal_lengths(
        _Measured(signature(a, rows_a, settings), a.length[rows_a], a.sigma[rows_a]),
        _Measured(signature(b, rows_b, settings), b.length[rows_b], b.sigma[rows_b]),
        settings.length_bound_sigmas,
    )
    return confirm_links(a, b, rows_a[i], rows_b[j], settings)


def confirm_links(
    a: Structure,
    b: Structure,
    dart_a: IntArray,
    dart_b: IntArray,
    settings: GrowthSettings = DEFAULT_GROWTH,
) -> Links:
    """Links of darts whose lengths agree: those of which the vertices at both ends pair, too."""
    node = _slot_nodes if is_rectilinear(a, b, settings) else _angle_nodes
    return node(a, b, dart_a, dart_b, settings)


def join_links(parts: list[Links]) -> Links:
    """Links found in parts, as if found at once, in the order of their darts."""
    names = ("dart_a", "dart_b", "start", "end")
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
    order = np.lexsort((columns[1], columns[0]))
    return Links(*(column[order] for column in columns))


def _slot_signature(s: Structure, darts: IntArray, settings: GrowthSettings) -> FloatArray:
    """What two darts must share in a rectilinear world, seen with the dart leaving eastwards.

    The turn between leaving and arriving and, if degrees are exact, the slots at both ends.
    """
    out, turn = s.out_slot[darts], (s.in_slot[darts] - s.out_slot[darts]) % 4
    if settings.degree == "inexact":
        return turn.astype(np.float64)
    at_start = TURNED[s.mask[s.start[darts]], -out % 4]
    at_end = TURNED[s.mask[s.end[darts]], -out % 4]
    return np.asarray((turn * 16 + at_start) * 16 + at_end, np.float64)


def _degree_signature(s: Structure, darts: IntArray, settings: GrowthSettings) -> FloatArray:
    """What two darts must share on general angles: the degrees of both ends, if exact."""
    if settings.degree == "inexact":
        return np.zeros(len(darts))
    return (s.degree[s.start[darts]] * 64 + s.degree[s.end[darts]]).astype(np.float64)


class _Measured(NamedTuple):
    """Corridors to compare: what must be equal, and what must be close."""

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
    order_x, order_y = np.argsort(key_x, kind="stable"), np.argsort(key_y, kind="stable")
    reach = bound_sigmas * np.sqrt(2.0)
    cap = span / 2 - 0.5  # a window never reaches the next kind
    i, j = _windows(key_x[order_x], np.minimum(reach * x.sigma[order_x], cap), key_y[order_y])
    i, j = order_x[i], order_y[j]
    k, h = _windows(key_y[order_y], np.minimum(reach * y.sigma[order_y], cap), key_x[order_x])
    k, h = order_y[k], order_x[h]
    wide, other = x.sigma[i] >= y.sigma[j], y.sigma[k] > x.sigma[h]
    i, j = np.concatenate([i[wide], h[other]]), np.concatenate([j[wide], k[other]])
    near = np.abs(x.length[i] - y.length[j]) <= bound_sigmas * np.hypot(x.sigma[i], y.sigma[j])
    return i[near], j[near]


def _windows(
    centre: FloatArray, half_width: FloatArray, keys: FloatArray
) -> tuple[IntArray, IntArray]:
    """All (row of centre, row of sorted keys) with the key inside the row's window."""
    low = np.searchsorted(keys, centre - half_width, "left")
    count = np.searchsorted(keys, centre + half_width, "right") - low
    rows = np.repeat(np.arange(len(centre)), count)
    offsets = np.cumsum(count) - count
    return rows, np.arange(len(rows)) + np.repeat(low - offsets, count)


# --- nodes: pairs of vertices under a correspondence of their branches ----------------------------


def _slot_nodes(
    a: Structure, b: Structure, dart_a: IntArray, dart_b: IntArray, settings: GrowthSettings
) -> Links:
    """Rectilinear world: a node is (vertex of a, vertex of b, quarter turns of b).

    Exact degrees: the darts' signatures have already compared the vertices.
    """
    turn = (a.out_slot[dart_a] - b.out_slot[dart_b]) % 4
    if settings.degree == "inexact":
        ok = _masks_agree(a.mask[a.start[dart_a]], b.mask[b.start[dart_b]], turn, settings)
        ok &= _masks_agree(a.mask[a.end[dart_a]], b.mask[b.end[dart_b]], turn, settings)
        dart_a, dart_b, turn = dart_a[ok], dart_b[ok], turn[ok]
    start = (a.start[dart_a] * len(b) + b.start[dart_b]) * 4 + turn
    end = (a.end[dart_a] * len(b) + b.end[dart_b]) * 4 + turn
    return Links(dart_a, dart_b, start, end)


def _masks_agree(
    mask_a: IntArray, mask_b: IntArray, turn: IntArray, settings: GrowthSettings
) -> NDArray[np.bool_]:
    """Whether slot sets agree when b's are turned: equal, or nearly so if degrees are inexact."""
    turned = TURNED[mask_b, turn]
    if settings.degree == "exact":
        return np.asarray(turned == mask_a)
    spare = settings.unmatched_branches
    extra_a, extra_b = POPCOUNT[mask_a & ~turned], POPCOUNT[turned & ~mask_a]
    return np.asarray((extra_a <= spare) & (extra_b <= spare) & ((mask_a & turned) != 0))


def _angle_nodes(
    a: Structure, b: Structure, dart_a: IntArray, dart_b: IntArray, settings: GrowthSettings
) -> Links:
    """General world: a node is (vertex of a, vertex of b, partner of each branch of a)."""
    leave = (a.start[dart_a], a.out_branch[dart_a]), (b.start[dart_b], b.out_branch[dart_b])
    arrive = (a.end[dart_a], a.in_branch[dart_a]), (b.end[dart_b], b.in_branch[dart_b])
    ok_start, partner_start = correspond(a, b, *leave, settings)
    ok_end, partner_end = correspond(a, b, *arrive, settings)
    ok = ok_start & ok_end
    dart_a, dart_b = dart_a[ok], dart_b[ok]
    start = _encode(a, b, a.start[dart_a], b.start[dart_b], partner_start[ok])
    end = _encode(a, b, a.end[dart_a], b.end[dart_b], partner_end[ok])
    return Links(dart_a, dart_b, start, end)


def correspond(
    a: Structure, b: Structure, at_a: Ends, at_b: Ends, settings: GrowthSettings = DEFAULT_GROWTH
) -> tuple[NDArray[np.bool_], IntArray]:
    """Correspondences of the branches of (k,) vertex pairs, given one pair of branches (§2.1).

    Returns ok (k,): whether the vertices are compatible that way; partner (k, D_a): for each
    branch of a its partner in b, -1 for none. Correspondences keep the order around the vertex: a
    plane map has no mirror image.
    """
    if settings.degree == "exact":
        return _all_branches(a, b, at_a, at_b, settings)
    return _most_branches(a, b, at_a, at_b, settings)


def _all_branches(
    a: Structure, b: Structure, at_a: Ends, at_b: Ends, settings: GrowthSettings
) -> tuple[NDArray[np.bool_], IntArray]:
    """Equal degrees: branch i of a goes with branch i + shift of b, all within the tolerance."""
    (vertex_a, branch_a), (vertex_b, branch_b) = at_a, at_b
    degree, shift = a.degree[vertex_a], branch_b - branch_a
    equal = degree == b.degree[vertex_b]
    columns = np.arange(a.heading.shape[1])
    inside = (columns < degree[:, None]) & equal[:, None]
    partner = np.where(inside, (columns + shift[:, None]) % np.maximum(degree, 1)[:, None], -1)
    hb = b.heading[vertex_b[:, None], np.maximum(partner, 0)]
    anchor = a.heading[vertex_a, branch_a] - b.heading[vertex_b, branch_b]
    diff = np.where(inside, wrap(a.heading[vertex_a] - hb - anchor[:, None]), 0.0)
    mean = diff.sum(axis=1) / np.maximum(degree, 1)
    off = np.where(inside, np.abs(diff - mean[:, None]), 0.0)
    return equal & (off.max(axis=1, initial=0.0) <= settings.branch_tolerance_rad), partner


def _most_branches(
    a: Structure, b: Structure, at_a: Ends, at_b: Ends, settings: GrowthSettings
) -> tuple[NDArray[np.bool_], IntArray]:
    """Inexact degrees: a few branches of either vertex may have no partner."""
    # Strategy: the pair given fixes a rotation, mutually nearest branches within the tolerance
    # correspond, their mean difference is the rotation, and once more with that.
    (vertex_a, branch_a), (vertex_b, branch_b) = at_a, at_b
    ha, hb = a.heading[vertex_a], b.heading[vertex_b]
    rows, columns = np.arange(len(vertex_a)), np.arange(ha.shape[1])
    anchor = ha[rows, branch_a] - hb[rows, branch_b]
    rotation, partner = anchor, np.zeros(ha.shape, np.int64)
    for _ in range(2):
        off = np.abs(wrap(ha[:, :, None] - hb[:, None, :] - rotation[:, None, None]))
        off = np.where(np.isnan(off), np.inf, off)
        nearest, back = off.argmin(axis=2), off.argmin(axis=1)
        mutual = np.take_along_axis(back, nearest, axis=1) == columns
        gap = np.take_along_axis(off, nearest[:, :, None], axis=2)[:, :, 0]
        matched = mutual & (gap <= settings.branch_tolerance_rad)
        partner = np.where(matched, nearest, -1)
        diff = wrap(ha - np.take_along_axis(hb, nearest, axis=1) - anchor[:, None])
        count = matched.sum(axis=1)
        rotation = anchor + np.where(matched, diff, 0.0).sum(axis=1) / np.maximum(count, 1)
    spare = settings.unmatched_branches
    ok = (a.degree[vertex_a] - count <= spare) & (b.degree[vertex_b] - count <= spare)
    return ok & (partner[rows, branch_a] == branch_b), partner


def _encode(
    a: Structure, b: Structure, vertex_a: IntArray, vertex_b: IntArray, partner: IntArray
) -> IntArray:
    """One integer per (vertex of a, vertex of b, correspondence)."""
    base, size = b.heading.shape[1] + 1, _correspondences(a, b)
    if float(len(a)) * len(b) * size > 2.0**62:
        raise ValueError("junctions with this many branches cannot be matched")
    digits = np.array([base**k for k in range(a.heading.shape[1])], np.int64)
    return (vertex_a * len(b) + vertex_b) * size + (partner + 1) @ digits


def _correspondences(a: Structure, b: Structure) -> int:
    return int((b.heading.shape[1] + 1) ** a.heading.shape[1])


def decode(a: Structure, b: Structure, code: IntArray, rectilinear: bool) -> Nodes:
    """The nodes that codes stand for."""
    size = 4 if rectilinear else _correspondences(a, b)
    pair, correspondence = np.divmod(code, size)
    return Nodes(pair // len(b), pair % len(b), correspondence)


def partners(a: Structure, b: Structure, correspondence: IntArray) -> IntArray:
    """(k, D_a) partner in b of each branch of a, -1 for none, of encoded correspondences."""
    base = b.heading.shape[1] + 1
    digits = np.array([base**k for k in range(a.heading.shape[1])], np.int64)
    return np.asarray(correspondence[:, None] // digits % base - 1)


# --- components: the grown matches ----------------------------------------------------------------


def assemble(a: Structure, b: Structure, links: Links, settings: GrowthSettings) -> Growth:
    """Connected components of the links, and which of them an incompatibility rejects (§2.2)."""
    rectilinear = is_rectilinear(a, b, settings)
    size = len(links.start)
    code, inverse = np.unique(np.concatenate([links.start, links.end]), return_inverse=True)
    nodes = decode(a, b, code, rectilinear)
    ones = np.ones(size, np.int8)
    graph = coo_array((ones, (inverse[:size], inverse[size:])), shape=(len(code), len(code)))
    number, labels = connected_components(graph, directed=False)
    component = labels.astype(np.int64)
    # A branch driven in both maps whose corridors do not pair is an incompatibility.
    satisfied = _satisfied(a, b, links, inverse, rectilinear)
    conflict = satisfied < shared_branches(a, b, nodes, rectilinear)
    rejected = np.zeros(number, np.bool_)
    rejected[component[conflict]] = True
    rejected[_not_one_to_one(nodes, component, rejected)] = True
    return Growth(
        nodes=nodes,
        component=component,
        rejected=rejected,
        links=links,
        link_component=component[inverse[:size]],
        rectilinear=rectilinear,
    )


def shared_branches(a: Structure, b: Structure, nodes: Nodes, rectilinear: bool) -> IntArray:
    """(N,) corresponding branches that were driven in both maps."""
    if rectilinear:
        turned = TURNED[b.explored_mask[nodes.vertex_b], nodes.correspondence]
        return np.asarray(POPCOUNT[a.explored_mask[nodes.vertex_a] & turned])
    partner = partners(a, b, nodes.correspondence)
    driven = b.explored[nodes.vertex_b[:, None], np.maximum(partner, 0)] & (partner >= 0)
    return np.asarray((a.explored[nodes.vertex_a] & driven).sum(axis=1))


def _satisfied(
    a: Structure, b: Structure, links: Links, node: IntArray, rectilinear: bool
) -> IntArray:
    """(N,) corresponding branches of each node along which a pair of corridors was found.

    node: (2 L,) the start nodes of all links, then their end nodes.
    """
    count = int(node.max(initial=-1)) + 1
    if not a.crowded and not b.crowded:
        return np.bincount(node, minlength=count)
    out, into = (a.out_slot, a.in_slot) if rectilinear else (a.out_branch, a.in_branch)
    branch = np.concatenate([out[links.dart_a], into[links.dart_a]])
    width = int(branch.max(initial=0)) + 1
    return np.bincount(np.unique(node * width + branch) // width, minlength=count)


def _not_one_to_one(nodes: Nodes, component: IntArray, rejected: NDArray[np.bool_]) -> IntArray:
    """Matches not yet rejected that pair a vertex twice."""
    alive = ~rejected[component]
    twice = []
    for vertex in (nodes.vertex_a, nodes.vertex_b):
        key = component[alive] * (int(vertex.max(initial=0)) + 1) + vertex[alive]
        order = np.argsort(key, kind="stable")
        again = key[order][1:] == key[order][:-1]
        twice.append(component[alive][order][1:][again])
    return np.concatenate(twice)


def node_rotations(a: Structure, b: Structure, nodes: Nodes, rectilinear: bool) -> FloatArray:
    """(N,) angle [rad] that takes b's directions to a's at each node."""
    if rectilinear:
        grid = (a.grid_rad or 0.0) - (b.grid_rad or 0.0)
        return np.asarray(wrap(grid + QUARTER * nodes.correspondence))
    partner = partners(a, b, nodes.correspondence)
    matched = partner >= 0
    hb = b.heading[nodes.vertex_b[:, None], np.maximum(partner, 0)]
    diff = np.where(matched, a.heading[nodes.vertex_a] - hb, 0.0)
    return np.asarray(np.angle((np.exp(1j * diff) * matched).sum(axis=1)))


# --- pairs of vertices that no corridor tests -----------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class SingleMatches:
    """Compatible nodes outside all grown matches that nothing contradicts (H1 of §2.3).

    candidates: compatible nodes in all, whether grown, single, or rejected by their first
    corridor; pairs: distinct vertex pairs among these.
    """

    nodes: Nodes
    candidates: int
    pairs: int


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
    return SingleMatches(
        nodes=nodes.take(shared_branches(a, b, nodes, False) == 0),
        candidates=len(nodes),
        pairs=len(np.unique(nodes.vertex_a * len(b) + nodes.vertex_b)),
    )


def candidate_nodes(a: Structure, b: Structure, settings: GrowthSettings = DEFAULT_GROWTH) -> Nodes:
    """All compatible pairs of vertices under all their correspondences (§2.1), ascending."""
    if not is_rectilinear(a, b, settings):
        return decode(a, b, _angle_candidates(a, b, settings), False)
    classes = _SlotClasses.of(a, b, settings)
    return classes.expanded(classes.compatible)


@dataclass(frozen=True, slots=True, eq=False)
class _SlotClasses:
    """Vertices of both maps in classes of equal (branch slots, driven slots).

    compatible: (C_a, C_b, 4) whether vertices of two classes pair under a quarter turn; disjoint:
    likewise, whether they share no driven branch; rows: vertices by class; first: (C + 1,) where
    each class begins in them.
    """

    compatible: NDArray[np.bool_]
    disjoint: NDArray[np.bool_]
    rows: tuple[IntArray, IntArray]
    first: tuple[IntArray, IntArray]

    @classmethod
    def of(cls, a: Structure, b: Structure, settings: GrowthSettings) -> _SlotClasses:
        kinds, rows, first = [], [], []
        for s in (a, b):
            kind = s.mask * 16 + s.explored_mask
            order = np.argsort(kind, kind="stable")
            known, start = np.unique(kind[order], return_index=True)
            kinds.append(known)
            rows.append(order)
            first.append(np.append(start, len(order)))
        turns = np.arange(4)
        mask_a, driven_a = (k[:, None, None] for k in np.divmod(kinds[0], 16))
        mask_b, driven_b = (k[None, :, None] for k in np.divmod(kinds[1], 16))
        return cls(
            compatible=_masks_agree(mask_a, mask_b, turns, settings) & (mask_a > 0),
            disjoint=np.asarray((driven_a & TURNED[driven_b, turns]) == 0),
            rows=(rows[0], rows[1]),
            first=(first[0], first[1]),
        )

    @property
    def sizes(self) -> IntArray:
        """(C_a, C_b) vertex pairs of each pair of classes."""
        return np.asarray(np.diff(self.first[0])[:, None] * np.diff(self.first[1]))

    def expanded(self, chosen: NDArray[np.bool_]) -> Nodes:
        """The nodes of the chosen (class, class, turn), ascending."""
        # Strategy: a flat ragged product; node k of a triple is (k // width, k % width) of it.
        i, j, turn = np.nonzero(chosen)
        count, width = self.sizes[i, j], np.diff(self.first[1])[j]
        triple = np.repeat(np.arange(len(i)), count)
        within = np.arange(len(triple)) - np.repeat(np.cumsum(count) - count, count)
        x, y = np.divmod(within, width[triple])
        vertex_a = self.rows[0][self.first[0][i][triple] + x]
        vertex_b = self.rows[1][self.first[1][j][triple] + y]
        nodes = Nodes(vertex_a, vertex_b, turn[triple])
        return nodes.take(np.lexsort((nodes.correspondence, vertex_b, vertex_a)))


def _slot_singles(a: Structure, b: Structure, settings: GrowthSettings) -> SingleMatches:
    classes = _SlotClasses.of(a, b, settings)
    return SingleMatches(
        nodes=classes.expanded(classes.compatible & classes.disjoint),
        candidates=int((classes.compatible.sum(axis=2) * classes.sizes).sum()),
        pairs=int((classes.compatible.any(axis=2) * classes.sizes).sum()),
    )


def _angle_candidates(a: Structure, b: Structure, settings: GrowthSettings) -> IntArray:
    """Codes of all compatible nodes on general angles, ascending; chunked over vertices of a."""
    chunk = max(1, 200_000 // max(1, len(b) * b.heading.shape[1] * a.heading.shape[1]))
    found = [
        _angle_candidates_of(a, b, np.arange(low, min(low + chunk, len(a))), settings)
        for low in range(0, len(a), chunk)
    ]
    return np.unique(np.concatenate(found)) if found else np.zeros(0, np.int64)


def _angle_candidates_of(
    a: Structure, b: Structure, rows: IntArray, settings: GrowthSettings
) -> IntArray:
    # Every branch of b may go with the first of a; with inexact degrees the first may be missing.
    first = a.heading.shape[1] if settings.degree == "inexact" else min(a.heading.shape[1], 1)
    u, i, v, j = (
        x.reshape(-1)
        for x in np.meshgrid(
            rows,
            np.arange(first),
            np.arange(len(b)),
            np.arange(b.heading.shape[1]),
            indexing="ij",
        )
    )
    real = (i < a.degree[u]) & (j < b.degree[v])
    if settings.degree == "exact":
        real &= a.degree[u] == b.degree[v]
    u, i, v, j = u[real], i[real], v[real], j[real]
    ok, partner = correspond(a, b, (u, i), (v, j), settings)
    return _encode(a, b, u[ok], v[ok], partner[ok])
