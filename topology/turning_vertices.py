"""Conversion of turning points to vertices of a map, for documents, drawings and route graphs, and
back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .columns import columns_and, columns_of
from .ragged import Ragged
from .topomap import MAP_EDGE_COLUMNS, MAP_VERTEX_COLUMNS, TopoMap
from .turning_points import KINDS, NO_TURNING_POINTS, WAY_COLUMNS, TurningPoints


def with_turning_points(topomap: TopoMap) -> TopoMap:
    """The map with its turning points as its last vertices, of one branch each, and the corridors
    to them as its last edges. Their confidence is that of the junctions they start from."""
    t = topomap.turning_points
    if len(t) == 0:
        return topomap
    n, k = len(topomap), len(t)
    time_ns = np.concatenate([topomap.observation_time_ns, *(times[:, 0] for times in t.time_ns)])
    new_vertex = np.repeat(np.arange(n, n + k), [len(times) for times in t.time_ns])
    vertex = np.concatenate([topomap.observation_vertex, new_vertex])
    order = np.lexsort((vertex, time_ns))
    ends = np.arange(k + 1)
    columns = {
        "xy": t.xy,
        "branches": Ragged(ends, t.heading),
        "kind": t.kind,
        "position_sigma": t.position_sigma,
        "branch_sigma": Ragged(ends, t.branch_sigma),
        "confidence": topomap.confidence[t.vertex],
        "area_m2": np.zeros(k),
        "width_m": np.zeros(k),
        "source": t.vertex,
        "target": np.arange(n, n + k),
        "source_branch": t.branch,
        "target_branch": np.zeros(k, np.int64),
        **{name: getattr(t, name) for name in WAY_COLUMNS},
    }
    return replace(
        topomap,
        **columns_and(topomap, columns),
        observation_vertex=vertex[order],
        observation_time_ns=time_ns[order],
        turning_points=NO_TURNING_POINTS,
    )


def without_turning_points(topomap: TopoMap) -> TopoMap:
    """The inverse: vertices that are turning points become `turning_points` of the map. Raises
    ValueError if they are not the last ones, or have other corridors than one from a junction."""
    n = next((k for k, kind in enumerate(topomap.kind) if kind in KINDS), len(topomap))
    k = len(topomap) - n
    if k == 0:
        return topomap
    m = len(topomap.source) - k
    fits = (
        set(topomap.kind[n:]) <= set(KINDS)
        and np.array_equal(topomap.target[m:], np.arange(n, n + k))
        and not np.any(topomap.source[m:] >= n)
        and not np.any(topomap.source[: max(m, 0)] >= n)
        and not np.any(topomap.target[: max(m, 0)] >= n)
        and np.array_equal(topomap.degree[n:], np.ones(k))
    )
    if not fits:
        raise ValueError(
            "turning points come last, each with one branch and one corridor, which leads to it "
            "from a junction, in the order of the turning points"
        )
    is_turning = topomap.observation_vertex >= n
    vertex, time_ns = topomap.observation_vertex, topomap.observation_time_ns
    vertex_columns = columns_of(topomap, MAP_VERTEX_COLUMNS, np.arange(n, n + k))
    edge_columns = columns_of(topomap, MAP_EDGE_COLUMNS, np.arange(m, m + k))
    sigma, turn, times = (
        vertex_columns["position_sigma"],
        vertex_columns["branch_sigma"],
        edge_columns["traversal_ns"],
    )
    points = TurningPoints(
        kind=vertex_columns["kind"],
        vertex=edge_columns["source"],
        branch=edge_columns["source_branch"],
        heading=vertex_columns["branches"].values,
        length=edge_columns["length"],
        length_sigma=edge_columns["length_sigma"],
        position_sigma=edge_columns["length_sigma"] if sigma is None else sigma,
        branch_sigma=np.zeros(k) if turn is None else turn.values,
        traversals=edge_columns["traversals"],
        paths=edge_columns["paths"],
        traversal_ns=(np.zeros((0, 2), np.int64),) * k if times is None else times,
        time_ns=tuple(time_ns[vertex == n + i][:, None] for i in range(k)),
    )
    return replace(
        topomap,
        **columns_of(topomap, MAP_VERTEX_COLUMNS, np.arange(n)),
        **columns_of(topomap, MAP_EDGE_COLUMNS, np.arange(m)),
        observation_vertex=vertex[~is_turning],
        observation_time_ns=time_ns[~is_turning],
        turning_points=points,
    )
