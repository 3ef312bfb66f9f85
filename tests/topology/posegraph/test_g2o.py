"""g2o files: round trips, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from topobatch.topology.errors import DocumentError
from topobatch.topology.posegraph.g2o import read_g2o, write_g2o
from topobatch.topology.posegraph.solve import PoseGraph, Priors, solve
from topobatch.topology.se2 import between

TRIANGLE = """\
# a triangle, with ids that have gaps
VERTEX_SE2 7 0 0 0
VERTEX_SE2 3 1 0 1.5707963267948966

VERTEX_SE2 12 1 1 3.14
FIX 7
EDGE_SE2 7 3 1 0 1.57 500 10 1 400 2 5000
EDGE_SE2 3 12 1 0 1.57 500 0 0 500 0 5000
EDGE_SE2 12 7 1 -1 -3.14 500 0 0 500 0 5000
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "graph.g2o"
    path.write_text(text, encoding="utf-8")
    return path


def test_reads_vertices_edges_and_fixes(tmp_path: Path) -> None:
    found = read_g2o(write(tmp_path, TRIANGLE))
    assert found.ids.tolist() == [3, 7, 12]
    graph = found.graph
    np.testing.assert_allclose(graph.pose[1], 0)
    np.testing.assert_allclose(graph.pose[2], [1, 1, 3.14])
    assert graph.source.tolist() == [1, 0, 2]
    assert graph.target.tolist() == [0, 2, 1]
    np.testing.assert_array_equal(graph.information[0], [[500, 10, 1], [10, 400, 2], [1, 2, 5000]])
    assert graph.held.tolist() == [[False] * 3, [True] * 3, [False] * 3]
    assert solve(graph).converged


def test_what_is_written_reads_back_bit_for_bit(tmp_path: Path) -> None:
    graph = read_g2o(write(tmp_path, TRIANGLE))
    path = tmp_path / "again.g2o"
    write_g2o(path, graph.graph, graph.ids)
    again = read_g2o(path)
    np.testing.assert_array_equal(again.ids, graph.ids)
    for name in ("pose", "source", "target", "measurement", "information", "held"):
        np.testing.assert_array_equal(getattr(again.graph, name), getattr(graph.graph, name))


def test_poses_come_from_the_edges_where_there_are_none(tmp_path: Path) -> None:
    edges = [line for line in TRIANGLE.splitlines() if line.startswith("EDGE")]
    graph = read_g2o(write(tmp_path, "\n".join(edges))).graph
    chained = between(graph.pose[graph.source], graph.pose[graph.target])
    # A tree of edges is met exactly: all but one of the three.
    assert np.isclose(chained, graph.measurement).all(axis=1).sum() >= 2


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1", "unknown line 'VERTEX_SE3:QUAT'"),
        ("VERTEX_SE2 1 0 0", "needs 4 numbers, found 3"),
        ("VERTEX_SE2 1 0 0 north", "'north' is no number"),
        ("VERTEX_SE2 1 0 0 nan", "not finite"),
        ("VERTEX_SE2 1.5 0 0 0", "'1.5' is no vertex id"),
        ("VERTEX_SE2 -1 0 0 0", "out of range"),
        ("VERTEX_SE2 7 0 0 0", "vertex 7 is given twice"),
        ("EDGE_SE2 7 99 1 0 0 1 0 0 1 0 1", "no vertex of the file"),
        ("EDGE_SE2 7 7 1 0 0 1 0 0 1 0 1", "joins a vertex to itself"),
        ("EDGE_SE2 7 3 1 0 0 1 5 0 1 0 1", "positive semidefinite"),
        ("EDGE_SE2 7 3 1 0 0 1 0 0 1 0", "needs 11 numbers, found 10"),
        ("FIX 55", "vertex 55, which is not there"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = write(tmp_path, TRIANGLE + line + "\n")
    with pytest.raises(DocumentError, match=message) as caught:
        read_g2o(path)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    if "FIX" not in line:
        assert f":{len(TRIANGLE.splitlines()) + 1}:" in text


@pytest.mark.parametrize("content", [b"", b"# nothing\n", b"\xff\xfe\x00"])
def test_files_without_a_graph_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "empty.g2o"
    path.write_bytes(content)
    with pytest.raises(DocumentError, match=r"empty\.g2o"):
        read_g2o(path)
    with pytest.raises(DocumentError, match="cannot be read"):
        read_g2o(tmp_path / "missing.g2o")


def test_what_the_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    none = np.zeros(0, np.int64)
    priors = Priors.headings(np.array([0]), np.zeros(1), 0.1)
    graph = PoseGraph(
        np.zeros((1, 3)), none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)), priors=priors
    )
    with pytest.raises(ValueError, match="g2o holds"):
        write_g2o(tmp_path / "x.g2o", graph)


@given(st.text(alphabet="VERTEXDGSFI_2 0123456789.-+en\n#", max_size=200))
def test_any_text_is_read_or_refused_with_a_document_error(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = write(tmp_path_factory.mktemp("g2o"), text)
    try:
        graph = read_g2o(path).graph
    except DocumentError:
        return
    assert np.isfinite(graph.pose).all()
