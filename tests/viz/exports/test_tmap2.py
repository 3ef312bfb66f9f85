"""LCAS's maps, read by the rules of their schema."""

from __future__ import annotations

import math
from itertools import combinations, pairwise

import networkx as nx
import pytest
import yaml

from .readers import read_tmap2, text_of


def test_the_planner_finds_the_shortest_way(driven) -> None:
    """A* over `weight`, with the way as the crow flies for what is left, as LCAS plans; one edge
    between two nodes, for it keeps no more."""
    read = read_tmap2(text_of(driven[1], "tmap2"))
    graph, xy = nx.DiGraph(read), nx.get_node_attributes(read, "xy")

    def straight(a: str, b: str) -> float:
        return math.dist(xy[a], xy[b])

    for start, end in combinations([n for n in graph if n.startswith("junction")], 2):
        way = nx.astar_path(graph, start, end, heuristic=straight, weight="weight")
        shortest = nx.shortest_path_length(graph, start, end, weight=lambda a, b, _: straight(a, b))
        assert sum(straight(a, b) for a, b in pairwise(way)) == pytest.approx(shortest, abs=0.02)


def test_areas_of_nodes_do_not_touch(driven) -> None:
    nodes = yaml.safe_load(text_of(driven[1], "tmap2"))["nodes"]
    reach = [max(math.hypot(v["x"], v["y"]) for v in n["node"]["verts"]) for n in nodes]
    at = [(p["x"], p["y"]) for p in (n["node"]["pose"]["position"] for n in nodes)]
    for a, b in combinations(range(len(nodes)), 2):
        assert reach[a] + reach[b] < math.dist(at[a], at[b]) + 0.005
