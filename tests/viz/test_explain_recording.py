"""The recording of the paper's method: its table, its transforms, its placements."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from topobatch.merge.paper.explain import explain, lines
from topobatch.topology.topomap import TopoMap
from topobatch.viz.explain_recording import write_explain_recording

from .readback import Readback

Make = Callable[..., TopoMap]


def test_what_was_found_is_written_and_read_back(tmp_path: Path, make_map: Make) -> None:
    a, b = make_map("a/1"), make_map("b", (1.0, 2.0, 0.4))
    found = explain(a, b)
    write_explain_recording(tmp_path / "explain.rrd", a, b, found)
    got = Readback(tmp_path / "explain.rrd")
    assert got.identity == ("topobatch", "a/1 - b")
    assert got.blueprints == 1
    h, c = found.hypotheses, found.clusters
    assert len(h) > 0
    assert got.value("/transforms/hypotheses", "vertices") == h.size.tolist()
    assert got.value("/transforms/hypotheses", "hypothesis") == [*range(1, len(h) + 1)]
    assert got.value("/transforms/hypotheses", "cluster") == (c.of + 1).tolist()
    labels = got.value("/transforms/clusters", "Points3D:labels")
    assert labels[0] == f"1: {c.vertices[0]} pairs"
    matched = np.unique(h.vertex_a[c.of[h.of] == 0])
    rings = got.value("/placements/cluster\\ 1/matched", "Points2D:positions")
    assert len(rings) == len(matched)
    assert "/placements/cluster\\ 1/a/a\\/1/corridors" in got.entities
    told = got.value("/summary", "TextDocument:text")[0]
    assert all(line in told for line in lines(found))
