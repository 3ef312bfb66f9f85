"""Corridors as straight pieces, and the three formats made of them."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

from topobatch.topology.polyline import way_of
from topobatch.viz.exports.route_graph import route_graph

from .readers import distance, read_nav2, read_rmf, read_tmap2, route_sigma, text_of

READERS = {"nav2": read_nav2, "rmf": read_rmf, "tmap2": read_tmap2}


def lengths(graph: nx.MultiDiGraph) -> list[float]:
    at = nx.get_node_attributes(graph, "xy")
    return [float(np.hypot(*np.subtract(at[u], at[v]))) for u, v in graph.edges()]


@pytest.mark.parametrize("form", READERS)
def test_route_graphs_keep_every_corridor_in_both_directions(form, driven, odd_map) -> None:
    for topomap in (driven[1], odd_map):
        graph = READERS[form](text_of(topomap, form))
        assert nx.is_strongly_connected(graph)
        assert sum(lengths(graph)) == pytest.approx(
            2 * sum(way_of(p)[-1] for p in topomap.paths), rel=0.01
        )
        back = sorted((v, u) for u, v in graph.edges())
        assert sorted(graph.edges()) == back


def test_straight_pieces_stay_near_the_path(driven) -> None:
    for bound in (0.02, 0.3):
        graph = route_graph(driven[1], bound)
        for edge, path in enumerate(driven[1].paths):
            rows = np.flatnonzero(graph.edge == edge)
            line = graph.xy[np.append(graph.source[rows], graph.target[rows[-1:]])]
            assert distance(path, line).max() <= bound + 1e-9
    assert len(route_graph(driven[1], 0.02).xy) > len(route_graph(driven[1], 0.3).xy)
    with pytest.raises(ValueError, match="positive"):
        route_graph(driven[1], 0.0)


def test_the_sigmas_of_the_pieces_add_up_to_those_of_the_corridors(driven) -> None:
    """By the formula of docs/exports.md, whatever part of them is the scale's, and however coarse
    the pieces; to no less than the scale's part, where a corridor states less."""
    _, topomap = driven
    for scale in (0.0, 0.002, topomap.measured.scale, 0.1):
        noise = replace(topomap.measured, scale=scale)
        stretched = replace(topomap, noise=noise, fitted_noise=noise)
        for bound in (0.02, 0.3):
            graph = route_graph(stretched, bound)
            whole = [
                route_sigma(graph.length[row], graph.length_sigma[row], scale)
                for row in (graph.edge == e for e in range(len(topomap.source)))
            ]
            least = scale * topomap.length
            assert whole == pytest.approx(np.maximum(topomap.length_sigma, least))
    assert (topomap.measured.scale * topomap.length < topomap.length_sigma).all()
    assert np.bincount(route_graph(topomap, 0.02).edge).max() > 1
