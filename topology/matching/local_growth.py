"""Growing only the matches that hold some given pairs of vertices, corridor by corridor (§4.2).

Where `association` finds all pairs of corridors at once, this follows them from node to node, so
that what no seed leads to is never compared.
"""

from __future__ import annotations

import numpy as np

from ..columns import take
from .association import (
    Growth,
    Links,
    assemble,
    confirm_links,
    dart_kind,
    join_links,
    search_bound,
)
from .correspondence import (
    DEFAULT_GROWTH,
    GrowthSettings,
    Nodes,
    decode,
    is_rectilinear,
    leaves_alike,
    node_codes,
)
from .structure import IntArray, Structure


def grow_from(
    a: Structure, b: Structure, seeds: Nodes, settings: GrowthSettings = DEFAULT_GROWTH
) -> Growth:
    """The matches of `grow` that hold one of the seeds; no other corridors are compared (§4.2).

    O(the matches grown), in as many rounds as the longest of them has corridors in a row.
    """
    none = np.zeros(0, np.int64)
    found = [Links(none, none, none, none)]
    reached = front = node_codes(a, b, seeds, is_rectilinear(a, b, settings))
    while len(front):
        found.append(_links_from(a, b, front, settings))
        front = np.setdiff1d(found[-1].end, reached)
        reached = np.union1d(reached, front)
    links = join_links([_forwards(part) for part in found])
    first = np.ones(len(links.start), np.bool_)  # a link is found from both of its ends
    first[1:] = (np.diff(links.dart_a) != 0) | (np.diff(links.dart_b) != 0)
    return assemble(a, b, Links(*(column[first] for column in links)), settings)


def _links_from(a: Structure, b: Structure, front: IntArray, settings: GrowthSettings) -> Links:
    """All links that leave the given nodes."""
    rectilinear = is_rectilinear(a, b, settings)
    nodes = decode(a, b, front, rectilinear)
    row_a, dart_a = _leaving(a, nodes.vertex_a)
    row_b, dart_b = _leaving(b, nodes.vertex_b[row_a])
    dart_a, nodes = dart_a[row_b], take(nodes, row_a[row_b])
    bound = search_bound(a, b, settings) * np.hypot(a.sigma[dart_a], b.sigma[dart_b])
    ok = leaves_alike(a, b, nodes, (dart_a, dart_b), rectilinear)
    ok &= np.abs(a.length[dart_a] - b.length[dart_b]) <= bound
    dart_a, dart_b = dart_a[ok], dart_b[ok]
    kinds = (dart_kind(s, d, settings, rectilinear) for s, d in ((a, dart_a), (b, dart_b)))
    ok = np.equal(*kinds)
    links = confirm_links(a, b, dart_a[ok], dart_b[ok], settings)
    mine = np.isin(links.start, front)
    return Links(*(column[mine] for column in links))


def _leaving(s: Structure, vertices: IntArray) -> tuple[IntArray, IntArray]:
    """(row of vertices, dart) for every dart that leaves one of the vertices."""
    order = np.argsort(s.start, kind="stable")
    low = np.searchsorted(s.start[order], vertices, "left")
    count = np.searchsorted(s.start[order], vertices, "right") - low
    rows = np.repeat(np.arange(len(vertices)), count)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    return rows, order[low[rows] + within]


def _forwards(links: Links) -> Links:
    """The same links, each by the forward dart of a."""
    back = links.dart_a % 2 == 1
    return Links(
        np.where(back, links.dart_a ^ 1, links.dart_a),
        np.where(back, links.dart_b ^ 1, links.dart_b),
        np.where(back, links.end, links.start),
        np.where(back, links.start, links.end),
    )
