"""What all formats have in common."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

from topobatch.topology.digits import significant
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.viz.exports import MAP_FORMATS
from topobatch.viz.exports.route_graph import seconds_sigma

from .readers import BOUND_M, read_csv, read_graphml, read_nav2, read_tmap2, route_sigma, text_of


def test_the_same_map_gives_the_same_text(driven) -> None:
    again = map_from_document(map_to_document(driven[1]))
    for writers in MAP_FORMATS.values():
        for write in writers.values():
            assert write(driven[1], BOUND_M) == write(again, BOUND_M)


def test_formats_that_state_lengths_say_how_sure_they_are(driven) -> None:
    """Of every edge; a route through every corridor has the same sigma by all of them."""
    topomap, scale = driven[1], significant(driven[1].measured.scale)
    length = route_sigma(topomap.length, topomap.length_sigma, scale)
    seconds = route_sigma(topomap.length, seconds_sigma(topomap), 0.0)

    def told(edges, time_sigma="seconds_sigma"):
        lengths, sigmas, times = (
            np.array([edge[name] for edge in edges], float)
            for name in ("length", "length_sigma", time_sigma)
        )
        assert route_sigma(lengths, sigmas, scale) == pytest.approx(length, rel=0.01)
        assert route_sigma(lengths, times, 0.0) == pytest.approx(seconds, rel=0.03)

    def one_way(graph):
        there = [(u, v) for u, v in graph.edges() if u < v]
        assert 2 * len(there) == graph.number_of_edges()
        return [graph.edges[u, v, k] for u, v, k in graph.edges(keys=True) if u < v]

    nav2, tmap2 = text_of(topomap, "nav2"), text_of(topomap, "tmap2")
    graph = read_graphml(text_of(topomap, "graphml"))
    rows = read_csv(MAP_FORMATS["csv"][".corridors.csv"](topomap, BOUND_M))
    told(one_way(read_nav2(nav2)), "time_sigma")
    told(one_way(read_tmap2(tmap2)))
    told([d for *_, d in graph.edges(data=True)])
    told(rows)
    assert json.loads(nav2)["length_scale_sigma"] == scale
    assert yaml.safe_load(tmap2)["meta"]["length_scale_sigma"] == scale
    assert graph.graph["length_scale_sigma"] == scale
    assert {row["length_scale_sigma"] for row in rows} == {str(scale)}
