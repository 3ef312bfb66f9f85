from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.merge.result import MergeResult
from topobatch.topology.topomap import TopoMap
from topobatch.viz.merged_recording import write_merged_recording

from ..topology.floors import floor, views_at
from .readback import Readback
from .test_report import drive

Merge = Callable[..., tuple[MergeResult, list[TopoMap]]]


def test_a_merge_is_written_and_read_back(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b", "c"], ["d"]], ambiguous=[("c", "d")])
    write_merged_recording(tmp_path / "merged.rrd", result, maps, [drive()])
    got = Readback(tmp_path / "merged.rrd")
    assert got.identity == ("topobatch", "merged")
    assert got.blueprints == 1
    assert not got.timelines
    at = np.array(got.value("/map/component_0/junctions", "Points2D:positions"))
    assert at == pytest.approx(result.fused.xy[:5], abs=1e-5)
    assert got.value("/map/component_0/junctions", "runs") == [3] * 5
    assert got.value("/map/component_1/junctions", "fused_from") == [f"d: {i}" for i in range(5)]
    for run in "abc":
        strands = got.value(f"/map/component_0/corridors/{run}", "LineStrips2D:strips")
        assert len(strands) == 5
        assert f"/runs/component_0/{run}/corridors" in got.entities
    assert got.value("/map/component_0/corridors/a", "driven_by") == ["a, b, c"] * 5
    assert got.value("/map/names", "Points2D:labels") == ["a", "b", "c"]
    (settles,) = got.value("/map/component_0/to\\ record", "settles")
    assert settles == "joins north and c, if they are one place: settles 1 open pair"


def test_maps_in_any_order_give_the_same_recording(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b"], ["c"]], ambiguous=[("a", "c")])
    write_merged_recording(tmp_path / "one.rrd", result, maps)
    write_merged_recording(tmp_path / "two.rrd", result, maps[::-1])
    assert Readback(tmp_path / "one.rrd").content() == Readback(tmp_path / "two.rrd").content()


def test_walls_of_a_site_are_one_picture(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b"], ["c"]])
    views = views_at(floor(1), [(20.0, 20.0, 0.2), (26.0, 20.0, 0.0)])
    views = replace(views, pose=views.pose - (20.0, 20.0, 0.0))
    write_merged_recording(tmp_path / "a.rrd", result, [replace(maps[0], views=views), *maps[1:]])
    got = Readback(tmp_path / "a.rrd")
    assert "/map/component_0/walls" in got.entities
    assert "/map/component_1/walls" not in got.entities
    (scale,) = got.value("/map/component_0/walls", "Transform3D:scale")
    assert scale == pytest.approx([0.1] * 3)
    assert "what the lasers of all runs saw" in got.value("/summary", "TextDocument:text")[0]
