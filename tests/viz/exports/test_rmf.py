"""Open-RMF's navigation graphs, read by the rules of its fleet adapter."""

from __future__ import annotations

from .readers import read_rmf, text_of


def test_names_are_read_as_they_are(odd_map) -> None:
    graph = read_rmf(text_of(odd_map, "rmf"))
    named = [data["name"] for _, data in graph.nodes(data=True) if data.get("name")]
    assert len(named) >= len(odd_map)
