"""What all formats have in common."""

from __future__ import annotations

import json

import pytest
import yaml

from topobatch.topology.digits import significant
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.viz.exports import MAP_FORMATS
from topobatch.viz.exports.route_graph import seconds_sigma

from .readers import BOUND_M, read_csv, read_graphml, read_nav2, read_tmap2, text_of


def test_the_same_map_gives_the_same_text(driven) -> None:
    again = map_from_document(map_to_document(driven[1]))
    for writers in MAP_FORMATS.values():
        for write in writers.values():
            assert write(driven[1], BOUND_M) == write(again, BOUND_M)


def test_formats_that_state_lengths_say_how_sure_they_are(driven) -> None:
    """Of a corridor, in squares over its pieces, of its time, and of all lengths together."""
    topomap, scale = driven[1], significant(driven[1].measured.scale)
    once = {"length_sigma": topomap.length_sigma, "seconds_sigma": seconds_sigma(topomap)}
    square = {name: float((sigma**2).sum()) for name, sigma in once.items()}

    def told(edges, names=("length_sigma", "seconds_sigma"), ways=1):
        for name, key in zip(names, square, strict=True):
            total = sum(float(edge[name]) ** 2 for edge in edges) / ways
            assert total == pytest.approx(square[key], rel=0.05)

    nav2, tmap2 = text_of(topomap, "nav2"), text_of(topomap, "tmap2")
    graph = read_graphml(text_of(topomap, "graphml"))
    rows = read_csv(MAP_FORMATS["csv"][".corridors.csv"](topomap, BOUND_M))
    told([d for *_, d in read_nav2(nav2).edges(data=True)], ("length_sigma", "time_sigma"), ways=2)
    told([d for *_, d in read_tmap2(tmap2).edges(data=True)], ways=2)
    told([d for *_, d in graph.edges(data=True)])
    told(rows)
    assert json.loads(nav2)["length_scale_sigma"] == scale
    assert yaml.safe_load(tmap2)["meta"]["length_scale_sigma"] == scale
    assert graph.graph["length_scale_sigma"] == scale
    assert {row["length_scale_sigma"] for row in rows} == {str(scale)}
