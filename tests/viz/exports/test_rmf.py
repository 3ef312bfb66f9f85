"""Open-RMF's navigation graphs, read by the rules of its fleet adapter."""

from __future__ import annotations

from .readers import read_rmf, text_of


def test_a_map_without_corridors_has_vertices(bare_map) -> None:
    graph = read_rmf(text_of(bare_map, "rmf"))
    assert (len(graph), graph.number_of_edges()) == (2, 0)


def test_names_are_read_as_they_are(odd_map) -> None:
    graph = read_rmf(text_of(odd_map, "rmf"))
    named = [data["name"] for _, data in graph.nodes(data=True) if data.get("name")]
    assert len(named) >= len(odd_map)
