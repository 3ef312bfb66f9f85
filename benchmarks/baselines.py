"""Other methods to align two maps, for comparison as in the paper.

Each takes two maps and returns T_a_b (3,), or None if it finds nothing.
"""

from __future__ import annotations

from itertools import pairwise

import networkx as nx
import numpy as np
from scipy.spatial import cKDTree

from topobatch.topology.matching.correspondence import candidate_nodes, node_rotations
from topobatch.topology.matching.structure import prepare
from topobatch.topology.se2 import apply, fit_rigid, wrap


def single_vertex_transform(a, b, gate_m=0.75):
    """Dedeoglu and Sukhatme: a transform from one pair of vertices, judged by what else it matches.

    Every compatible pair fixes a transform (position and branches); the one under which most
    vertices of b fall on compatible vertices of a wins and is fitted to them once more.
    """
    sa, sb = prepare(a), prepare(b)
    nodes = candidate_nodes(sa, sb)
    rectilinear = sa.grid_rad is not None and sb.grid_rad is not None
    turn = node_rotations(sa, sb, nodes, rectilinear)
    tree, best = cKDTree(a.xy), (0, None)
    c, s = np.cos(turn), np.sin(turn)
    p, q = a.xy[nodes.vertex_a], b.xy[nodes.vertex_b]
    shift = p - np.column_stack([c * q[:, 0] - s * q[:, 1], s * q[:, 0] + c * q[:, 1]])
    for low, high in pairwise([*range(0, len(nodes), 512), len(nodes)]):
        T = np.column_stack([shift[low:high], turn[low:high]])
        moved = apply(T[:, None, :], b.xy[None])
        distance, nearest = tree.query(moved, distance_upper_bound=gate_m)
        hit = np.isfinite(distance)
        hit &= a.degree[np.where(hit, nearest, 0)] == b.degree
        count = hit.sum(axis=1)
        k = int(count.argmax())
        if count[k] > best[0]:
            best = (int(count[k]), fit_rigid(a.xy[nearest[k][hit[k]]], b.xy[hit[k]]))
    return best[1]


def icp(a, b, start, gate_m=3.0, rounds=50):
    """Iterative closest point from a given start: nearest vertices, fit, again until it stays."""
    tree, T = cKDTree(a.xy), np.asarray(start, float)
    for _ in range(rounds):
        distance, nearest = tree.query(apply(T, b.xy), distance_upper_bound=gate_m)
        hit = np.isfinite(distance)
        if hit.sum() < 2:
            return None
        new = fit_rigid(a.xy[nearest[hit]], b.xy[hit])
        if np.abs(wrap(new - T)).max() < 1e-6:
            return new
        T = new
    return T


def icp_from_many_starts(a, b, rng, starts=200):
    """ICP from random starts; the one that brings most vertices within half a metre wins."""
    tree, best = cKDTree(a.xy), (0, None)
    for _ in range(starts):
        turn = rng.uniform(-np.pi, np.pi)
        onto, from_ = a.xy[rng.integers(len(a))], b.xy[rng.integers(len(b))]
        start = np.append(onto - apply(np.array([0, 0, turn]), from_), turn)
        T = icp(a, b, start)
        if T is not None:
            near = int((tree.query(apply(T, b.xy))[0] < 0.5).sum())
            best = max(best, (near, T), key=lambda x: x[0])
    return best[1]


def largest_common_subgraph(a, b, tolerance=0.05):
    """Largest common induced subgraph by networkx: only degrees and corridor lengths count.

    Exponential: for maps of up to about ten vertices.
    """
    graphs = [nx.Graph(), nx.Graph()]
    for graph, m in zip(graphs, (a, b), strict=True):
        graph.add_nodes_from((v, {"degree": int(d)}) for v, d in enumerate(m.degree))
        for u, v, length in zip(
            m.source.tolist(), m.target.tolist(), m.length.tolist(), strict=True
        ):
            graph.add_edge(u, v, length=length)
    small, large = sorted(graphs, key=len)
    matcher = nx.algorithms.isomorphism.ISMAGS(
        large,
        small,
        node_match=lambda x, y: x["degree"] == y["degree"],
        edge_match=lambda x, y: abs(x["length"] - y["length"]) < tolerance * max(x["length"], 1.0),
    )
    found = next(iter(matcher.largest_common_subgraph()), {})
    if len(found) < 2:
        return None
    onto, from_ = list(found), list(found.values())
    pairs = (onto, from_) if large is graphs[0] else (from_, onto)
    return fit_rigid(a.xy[pairs[0]], b.xy[pairs[1]])
