from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from topobatch.topology.topomap import TopoMap
from topobatch.viz.explain_recording import write_explain_recording

from .readback import Readback

Make = Callable[..., TopoMap]


def findings() -> SimpleNamespace:
    """As an Explanation: two clusters of three hypotheses, of four pairs and of one."""
    hypotheses = SimpleNamespace(
        of=np.array([0, 0, 0, 1, 2]),
        vertex_a=np.array([0, 1, 2, 3, 0]),
        vertex_b=np.array([0, 1, 2, 3, 4]),
        size=np.array([3, 1, 1]),
        corridors=np.array([2, 0, 0]),
        transform=np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (4.0, 2.0, np.pi / 2)]),
        error=np.array([0.01, 0.0, 0.0]),
    )
    clusters = SimpleNamespace(
        of=np.array([0, 0, 1]),
        transform=np.array([(0.02, 0.0, 0.0), (4.0, 2.0, np.pi / 2)]),
        vertices=np.array([4, 1]),
        hypotheses=np.array([2, 1]),
        largest=np.array([3, 1]),
        squared_error=np.array([0.04, 0.0]),
    )
    return SimpleNamespace(
        hypotheses=hypotheses,
        clusters=clusters,
        candidate_a=np.array([0, 1, 2, 3, 0, 4]),
        candidate_b=np.array([0, 1, 2, 3, 4, 2]),
        degree_a=np.array([3, 2, 3, 2, 1]),
        degree_b=np.array([3, 2, 3, 2, 1]),
    )


def nothing(degree_b: int) -> SimpleNamespace:
    none, poses = np.zeros(0, np.int64), np.zeros((0, 3))
    hypotheses = SimpleNamespace(
        of=none,
        vertex_a=none,
        vertex_b=none,
        size=none,
        corridors=none,
        transform=poses,
        error=np.zeros(0),
    )
    clusters = SimpleNamespace(
        of=none,
        transform=poses,
        vertices=none,
        hypotheses=none,
        largest=none,
        squared_error=np.zeros(0),
    )
    return SimpleNamespace(
        hypotheses=hypotheses,
        clusters=clusters,
        candidate_a=none,
        candidate_b=none,
        degree_a=np.zeros(5, np.int64),
        degree_b=np.zeros(degree_b, np.int64),
    )


def test_what_was_found_is_written_and_read_back(tmp_path: Path, make_map: Make) -> None:
    path = tmp_path / "explain.rrd"
    write_explain_recording(path, make_map("a/1"), make_map("b", (1.0, 2.0, 0.4)), findings())
    got = Readback(path)
    assert got.identity == ("topobatch", "a/1 - b")
    assert got.blueprints == 1
    assert got.value("/transforms/hypotheses", "vertices") == [3, 1, 1]
    assert got.value("/transforms/hypotheses", "hypothesis") == [1, 2, 3]  # as in the tables
    assert got.value("/transforms/hypotheses", "cluster") == [1, 1, 2]
    assert got.value("/transforms/clusters", "Points3D:labels") == ["1: 4 pairs", "2: 1 pair"]
    assert len(got.value("/placements/cluster\\ 1/matched", "Points2D:positions")) == 4
    assert "/placements/cluster\\ 2/a/a\\/1/corridors" in got.entities
    told = got.value("/summary", "TextDocument:text")[0]
    assert "**3** hypotheses, **2** clusters" in told
    assert "| 1 | 4 | 2 | 3 | 0.10 | (0.0, 0.0) m, 0° |" in told
    assert "| 3 | 2 | 1 | 0 | 0.00 | (4.0, 2.0) m, 90° |" in told


def test_nothing_found_is_told(tmp_path: Path, make_map: Make, empty_map: TopoMap) -> None:
    write_explain_recording(tmp_path / "a.rrd", make_map("a"), make_map("b"), nothing(5))
    write_explain_recording(tmp_path / "b.rrd", make_map("a"), empty_map, nothing(0))
    for name in ("a.rrd", "b.rrd"):
        told = Readback(tmp_path / name).value("/summary", "TextDocument:text")[0]
        assert "no pair of junctions is compatible" in told
        assert "**0** hypotheses, **0** clusters" in told
    found = nothing(5)
    found.candidate_a, found.candidate_b = np.array([1]), np.array([2])
    write_explain_recording(tmp_path / "c.rrd", make_map("a"), make_map("b"), found)
    told = Readback(tmp_path / "c.rrd").value("/summary", "TextDocument:text")[0]
    assert "**1** compatible pair, each rotation counted, **0** hypotheses" in told
    assert "none of them fits along its corridors" in told
