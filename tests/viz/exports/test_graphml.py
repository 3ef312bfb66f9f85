"""GraphML, read by networkx."""

from __future__ import annotations

import json

import networkx as nx

from topobatch.topology.document import map_to_document

from .readers import read_graphml, text_of


def test_graphml_holds_what_the_document_holds(driven) -> None:
    graph, document = (read_graphml(text_of(driven[1], "graphml")), map_to_document(driven[1]))
    ours = nx.node_link_graph(document, edges="edges")
    assert nx.utils.graphs_equal(
        nx.MultiGraph(ours.edges(keys=True)), nx.MultiGraph(graph.edges(keys=True))
    )
    for node, data in graph.nodes(data=True):
        assert json.loads(data["branches"]) == ours.nodes[node]["branches"]
        assert (data["x"], data["y"]) == (ours.nodes[node]["x"], ours.nodes[node]["y"])
    for u, v, key, data in graph.edges(keys=True, data=True):
        assert json.loads(data["path"]) == ours.edges[u, v, key]["path"]
        assert data["length"] == ours.edges[u, v, key]["length"]
