"""The map document: round trip, schema, errors that name the place."""

from __future__ import annotations

import copy
import json
import os

import jsonschema
import networkx as nx
import numpy as np
import pytest

from topobatch.merge.locks import DiscardsDocument, LocksDocument
from topobatch.merge.merged_schema import MergedDocument
from topobatch.topology.document import map_from_document, map_to_document, read_map, write_map
from topobatch.topology.errors import DocumentError
from topobatch.topology.map_schema import MapDocument, validated
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import Closure, TopoMap


def small_map(run: str = "run1") -> TopoMap:
    """Two junctions joined twice, a loop at the second, an unexplored branch at the first."""
    return TopoMap(
        run=run,
        frame="odom",
        xy=np.array([[0.0, 0.0], [4.0, 1.0]]),
        branches=Ragged.from_rows([[-3.0, 0.2, 1.5], [-2.5, -0.5, 0.5, 3.0]]),
        kind=("junction", "junction"),
        source=[0, 0, 1],
        target=[1, 1, 1],
        source_branch=[1, 2, 1],
        target_branch=[3, 0, 2],
        length=[4.2, 6.5, 7.0],
        length_sigma=[0.1, 0.2, 0.3],
        traversals=[2, 1, 1],
        paths=(
            np.array([[0.0, 0.0], [4.0, 1.0]]),
            np.array([[0.0, 0.0], [1.0, 3.0], [4.0, 1.0]]),
            np.array([[4.0, 1.0], [6.0, 0.0], [6.0, 2.0], [4.0, 1.0]]),
        ),
        observation_vertex=[0, 1, 0, 1],
        observation_time_ns=[
            1_700_000_000_000_000_001,
            1_700_000_000_000_000_005,
            2**62,
            2**62 + 1,
        ],
        closures=(
            Closure(1, 2, True, 12.5, "same branches", round=2),
            Closure(1, 3, False, 4.5, "taken back", round=5, accepted_round=3, revised=True),
            Closure(2, 3, False, -1.5, "weak"),
        ),
        info={"source": {"odometry": "/odom"}},
    )


def test_round_trip_is_exact():
    doc = map_to_document(small_map())
    text = json.dumps(doc)
    again = map_from_document(json.loads(text))
    assert json.dumps(map_to_document(again)) == text


def test_networkx_loads_it_with_parallel_edges_and_loops():
    graph = nx.node_link_graph(map_to_document(small_map()), edges="edges")
    assert isinstance(graph, nx.MultiGraph)
    assert graph.number_of_edges(0, 1) == 2
    assert graph.has_edge(1, 1)
    assert graph.nodes[1]["observations"][0]["time_ns"] == 1_700_000_000_000_000_005


def test_the_published_schema_accepts_it():
    jsonschema.validate(map_to_document(small_map()), MapDocument.model_json_schema(by_alias=True))


@pytest.mark.parametrize(
    ("model", "version", "told"),
    [
        (MapDocument, "topobatch.map/0", "older topobatch.*ingest its log again with --force"),
        (MapDocument, "topobatch.map/2", "newer topobatch.*ingest its log again with --force"),
        (MergedDocument, "topobatch.merged/0", "older topobatch.*topobatch merge --all"),
        (MergedDocument, "topobatch.merged/10", "newer topobatch.*topobatch merge --all"),
        (LocksDocument, "topobatch.locks/2", "newer topobatch.*lock again"),
        (DiscardsDocument, "topobatch.discards/0", "older topobatch.*discard again"),
        (MapDocument, "topobatch.merged/1", "Input should be 'topobatch.map/1'"),
        (MapDocument, "topobatch.map/1.5", "Input should be 'topobatch.map/1'"),
    ],
)
def test_other_versions_are_refused_with_the_way_out(model, version, told):
    with pytest.raises(DocumentError, match=told):
        validated(model, {"schema": version}, "run1.json")


@pytest.mark.parametrize(
    ("path", "value", "place"),
    [
        (["schema"], "other/1", "schema"),
        (["directed"], True, "directed"),
        (["nodes", 1, "x"], float("nan"), "nodes.1.x"),
        (["nodes", 0, "branches"], None, "nodes.0.branches"),
        (["edges", 2, "length"], -1, "edges.2.length"),
        (["edges", 0, "path"], [[0, 0]], "edges.0.path"),
        (["edges", 0, "path"], [[0, 0], [1e9, 0]], "edges.0.path"),
        (["edges", 0, "path"], [[3.2e7, 5e6], [3.2e7, 5e6 + 1.1e5]], "edges.0.path"),
        (["edges"], "twelve", "edges: all paths together"),
        (["edges", 0, "length"], 999e3, "edges.0.length"),
        (["nodes", 0, "branches"], [0.0] * 100_000, "nodes.0.branches"),
        (["edges", 1, "traversals"], 10**30, "edges.1.traversals"),
        (["edges", 1, "source_branch"], 2**63, "edges.1.source_branch"),
        (["nodes", 0, "y"], -1e300, "nodes.0.y"),
        (["nodes", 0, "observations", 0, "time_ns"], 10**30, "nodes.0.observations.0.time_ns"),
        (["graph", "noise", "branch_fault_rate"], -1, "graph.noise.branch_fault_rate"),
        (["graph", "noise", "centre_m"], 1e300, "graph.noise.centre_m"),
        (["edges", 0, "target"], 7, "does not exist"),
        (["edges", 0, "source_branch"], 3, "source_branch"),
        (["nodes", 0, "id"], 5, "node ids"),
        (["graph", "pieces"], 0, "graph.pieces"),
        (["graph", "pieces"], "several", "graph.pieces"),
    ],
)
def test_errors_name_the_place(path, value, place):
    doc = copy.deepcopy(map_to_document(small_map()))
    spot = doc
    for key in path[:-1]:
        spot = spot[key]
    if value == "twelve":
        value = [{**doc["edges"][0], "path": [[0, 0], [9e4, 0]], "length": 9e4}] * 12
    spot[path[-1]] = value
    with pytest.raises(DocumentError, match=place) as caught:
        map_from_document(doc, "maps/x.json")
    assert str(caught.value).startswith("maps/x.json: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"{", b"\xff\xfe", b"[" * 100_000, b"[" * 1000 + b"]" * 1000, b"3", b"null", b"NaN"),
        *(b'"\\ud800"', b'{"\xed\xa0\x80": 1}', b"9" * 5000),
    ],
)
def test_what_is_no_document_is_said_to_be_none(tmp_path, content):
    path = tmp_path / "x.json"
    path.write_bytes(content)
    with pytest.raises(DocumentError, match=r"x\.json"):
        read_map(path)


def test_written_files_are_whole_and_the_same_each_time(tmp_path):
    path = tmp_path / "maps" / "run1.json"
    write_map(path, small_map())
    first = path.read_bytes()
    write_map(path, small_map())
    assert path.read_bytes() == first
    assert os.listdir(path.parent) == ["run1.json"]
    assert read_map(path).run == "run1"
