"""Exports, each read back by its reader (`readers.py`)."""

from __future__ import annotations

import json
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation import ScenarioSettings, simulate_scenario
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.embedding import map_pose_graph
from topobatch.topology.errors import DataError
from topobatch.topology.polyline import way_of
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import TopoMap
from topobatch.viz.exports import (
    MAP_FORMATS,
    corrected_tum,
    pose_graph_g2o,
    recorded_tum,
    route_graph,
)

from . import readers

BOUND_M = 0.05


@pytest.fixture(scope="module")
def driven():
    """A simulated run among organic, winding ways, and its map as a document gives it."""
    settings = ScenarioSettings("organic", runs=1, junctions_per_run=14, odometry_hz=10, seed=3)
    (run,) = simulate_scenario(settings).runs.values()
    return run, map_from_document(map_to_document(build_map(run)))


@pytest.fixture
def odd_map() -> TopoMap:
    """A loop, two corridors between the same junctions, and a corridor that nobody timed."""
    bow = np.array([(0.0, 0.0), (2.0, 2.0), (4.0, 0.0)])
    loop = np.array([(4.0, 0.0), (6.0, 0.0), (6.0, 2.0), (4.0, 0.0)])
    paths = (bow[[0, 2]], bow, loop)
    none = np.full(3, -1)
    return TopoMap(
        run='no: "1e3"',
        frame="odom",
        xy=np.array([(0.0, 0.0), (4.0, 0.0)]),
        branches=Ragged.from_rows([[0.0, 0.8], [-3.0, 0.0, 0.8, 2.4]]),
        kind=("bend", "junction"),
        source=np.array([0, 0, 1]),
        target=np.array([1, 1, 1]),
        source_branch=none,
        target_branch=none,
        length=np.array([way_of(p)[-1] for p in paths]),
        length_sigma=np.full(3, 0.1),
        traversals=np.array([2, 1, 0]),
        paths=paths,
        observation_vertex=np.array([0, 1, 0]),
        observation_time_ns=np.array([10, 14, 18]) * 10**9,
        traversal_ns=(
            np.array([(10, 14), (22, 16)]) * 10**9,
            np.array([(18, 14)]) * 10**9,
            np.zeros((0, 2), np.int64),
        ),
    )


def text_of(topomap: TopoMap, form: str, bound: float = BOUND_M) -> str:
    (write,) = MAP_FORMATS[form].values()
    return write(topomap, bound)


def lengths(graph: nx.MultiDiGraph) -> list[float]:
    at = nx.get_node_attributes(graph, "xy")
    return [float(np.hypot(*np.subtract(at[u], at[v]))) for u, v in graph.edges()]


@pytest.mark.parametrize(("form", "read"), [("nav2", readers.read_nav2), ("rmf", readers.read_rmf),
                                            ("tmap2", readers.read_tmap2)])  # fmt: skip
def test_route_graphs_keep_every_corridor_in_both_directions(form, read, driven, odd_map) -> None:
    for topomap in (driven[1], odd_map):
        graph = read(text_of(topomap, form))
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


def distance(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """(k,) of points from a polyline."""
    a, d = line[:-1], np.diff(line, axis=0)
    t = ((points[:, None] - a) * d).sum(axis=2) / np.maximum((d * d).sum(axis=1), 1e-12)
    foot = a + np.clip(t, 0, 1)[..., None] * d
    return np.hypot(*(points[:, None] - foot).T).min(axis=0)


def test_nav2_times_are_the_medians_of_what_was_driven(odd_map) -> None:
    graph = readers.read_nav2(text_of(odd_map, "nav2"))
    taken: dict[int, list[float]] = {}
    for *_, data in graph.edges(data=True):
        taken.setdefault(data["corridor"], []).append(data.get("abs_time_taken"))
    assert taken[0] == [5.0, 5.0]  # 4 s there, 6 s back
    assert sum(taken[1]) == pytest.approx(2 * 4.0, abs=0.03)
    assert set(taken[2]) == {None}


def test_without_times_there_is_none(driven) -> None:
    text = text_of(replace(driven[1], traversal_ns=None), "nav2")
    readers.read_nav2(text)
    assert "abs_time_taken" not in text


def test_nav2_wants_a_corridor(odd_map) -> None:
    none = np.zeros(0, np.int64)
    bare = replace(
        odd_map, source=none, target=none, source_branch=none, target_branch=none,
        length=np.zeros(0), length_sigma=np.zeros(0), traversals=none, paths=(), traversal_ns=(),
    )  # fmt: skip
    with pytest.raises(DataError, match="no corridor"):
        text_of(bare, "nav2")
    assert readers.read_rmf(text_of(bare, "rmf")).number_of_edges() == 0
    assert len(readers.read_tmap2(text_of(bare, "tmap2"))) == 2
    assert readers.read_lif(text_of(bare, "lif")).layouts[0].edges == []
    assert [readers.read_csv(write(bare, 0.1)) for write in MAP_FORMATS["csv"].values()][1] == []


def test_lif_gives_curves_as_trajectories(driven, odd_map) -> None:
    for topomap in (driven[1], odd_map):
        (layout,) = readers.read_lif(text_of(topomap, "lif")).layouts
        assert len(layout.nodes) == len(topomap)
        assert len(layout.edges) == 2 * len(topomap.source)
        at = {n.node_id: (n.node_position.x, n.node_position.y) for n in layout.nodes}
        for k, path in enumerate(topomap.paths):
            one, back = layout.edges[2 * k : 2 * k + 2]
            assert (one.start_node_id, one.end_node_id) == (back.end_node_id, back.start_node_id)
            curve = one.vehicle_type_edge_properties[0].trajectory
            line = [at[one.start_node_id], at[one.end_node_id]]
            if curve is not None:
                line = [(p.x, p.y) for p in curve.control_points]
            assert distance(path, np.array(line)).max() < BOUND_M + 1e-3


def test_graphml_holds_what_the_document_holds(driven) -> None:
    graph, document = (
        readers.read_graphml(text_of(driven[1], "graphml")),
        map_to_document(driven[1]),
    )
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


def test_tables_have_a_row_for_everything(driven) -> None:
    junctions, corridors = (
        readers.read_csv(w(driven[1], 0.1)) for w in MAP_FORMATS["csv"].values()
    )
    assert [float(row["x"]) for row in junctions] == driven[1].xy[:, 0].tolist()
    assert [int(row["source"]) for row in corridors] == driven[1].source.tolist()
    assert sum(int(row["passes"]) for row in junctions) == len(driven[1].observation_vertex)
    assert all(0.2 < float(row["speed_m_per_s"]) < 1.5 for row in corridors)


def test_the_pose_graph_of_a_map_is_at_its_minimum(driven, tmp_path) -> None:
    given = map_pose_graph(driven[1])
    text = pose_graph_g2o(given)
    assert "#" not in text  # GTSAM would read no edges
    graph = readers.read_g2o_text(text, tmp_path)
    assert np.allclose(graph.pose[:, :2], driven[1].xy)
    assert np.allclose(graph.information, given.information, rtol=1e-5, atol=1e-3)
    assert np.array_equal(graph.source, given.source)


def test_trajectories_pass_where_the_junctions_are(driven) -> None:
    run, topomap = driven
    recorded = readers.read_tum(recorded_tum(run.odometry))
    assert len(recorded) == len(run.odometry)
    assert np.allclose(recorded[:, 1:3], run.odometry.pose[:, :2], atol=1e-6)
    yaw = 2 * np.arctan2(recorded[:, 6], recorded[:, 7])
    assert np.allclose(np.exp(1j * yaw), np.exp(1j * run.odometry.pose[:, 2]), atol=1e-6)
    corrected = readers.read_tum(corrected_tum(topomap, run.odometry) or "")
    at = np.searchsorted(corrected[:, 0], topomap.observation_time_ns * 1e-9)
    there = topomap.xy[topomap.observation_vertex]
    assert np.hypot(*(corrected[at, 1:3] - there).T).max() < 0.2
    moved = readers.read_tum(corrected_tum(topomap, run.odometry, np.array([1.0, 2.0, 0.5])) or "")
    assert moved[0, 1:3] == pytest.approx(
        np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]]) @ corrected[0, 1:3]
        + [1.0, 2.0],
        abs=1e-5,
    )


def test_the_same_map_gives_the_same_text(driven) -> None:
    again = map_from_document(map_to_document(driven[1]))
    for writers in MAP_FORMATS.values():
        for write in writers.values():
            assert write(driven[1], BOUND_M) == write(again, BOUND_M)
