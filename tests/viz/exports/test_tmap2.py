"""LCAS's maps, read by the rules of their schema."""

from __future__ import annotations

from .readers import read_tmap2, text_of


def test_a_map_without_corridors_has_nodes(bare_map) -> None:
    graph = read_tmap2(text_of(bare_map, "tmap2"))
    assert (len(graph), graph.number_of_edges()) == (2, 0)
