from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from topobatch.merge.result import Component, FusedMap, MergeResult
from topobatch.topology.topomap import TopoMap
from topobatch.viz import write_merged_recording

from .readback import Readback

Merge = Callable[..., tuple[MergeResult, list[TopoMap]]]


def test_a_merge_is_written_and_read_back(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b", "c"], ["d"]], ambiguous=[("c", "d")])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    assert got.identity == ("topobatch", "merged")
    assert got.blueprints == 1
    assert got.timelines == {"join"}
    for root in ("map", "agreement"):
        at = np.array(got.value(f"/{root}/component_0/junctions", "Points2D:positions"))
        assert at == pytest.approx(result.fused.xy[:5], abs=1e-5)
    assert got.value("/map/component_0/junctions", "runs") == [3] * 5
    assert got.value("/map/component_1/junctions", "fused_from") == [f"d: {i}" for i in range(5)]
    for run in "abc":
        strands = got.value(f"/map/component_0/corridors/{run}", "LineStrips2D:strips")
        assert len(strands) == 5
        assert f"/runs/component_0/{run}/corridors" in got.entities
    assert got.value("/agreement/component_0/corridors", "driven_by") == ["a, b, c"] * 5
    assert got.value("/verdicts/evidence", "reason") == [p.reason for p in result.verdicts]
    assert "/undecided/pairs/c/d/best/matched" in got.entities
    assert "/undecided/pairs/c/d/runner-up/b/d/corridors" in got.entities
    assert "two ways" in got.value("/pairs", "TextDocument:text")[0]


def test_strands_lie_side_by_side(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b"]])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    a, b = (
        np.array(got.value(f"/map/component_0/corridors/{run}", "LineStrips2D:strips")[0])
        for run in "ab"
    )
    radius = got.value("/map/component_0/corridors/a", "LineStrips2D:radii")[0]
    assert np.hypot(*(a - b).T) == pytest.approx(2 * radius)
    assert (a + b) / 2 == pytest.approx(result.fused.paths[0], abs=1e-5)


def test_runs_come_together_step_by_step(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b", "c"]])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    assert got.times("/steps/runs/a", "join").tolist() == [0, 1]
    assert got.times("/steps/runs/c", "join").tolist() == [0, 2]
    assert len(got.rows("/story", "TextDocument:text")) == 3


def test_many_components_are_laid_side_by_side(tmp_path: Path, merge_of: Merge) -> None:
    names = [f"run {i:02d}" for i in range(30)]
    result, maps = merge_of([[name] for name in names])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    places = [got.value(f"/map/component_{i}", "Transform3D:translation")[0] for i in range(30)]
    assert len({tuple(place) for place in places}) == 30
    assert got.value("/map/titles", "Points2D:labels") == names
    assert "/undecided" not in got.entities
    assert "/steps" not in got.entities


@pytest.mark.parametrize(
    "names", [["Flur 2/Süd", "Flur 2\\Nord"], ["..", "."], ["日本", "a|b*_#"], ["", " "]]
)
def test_any_run_names_are_written(tmp_path: Path, merge_of: Merge, names: list[str]) -> None:
    result, maps = merge_of([sorted(names)])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    strands = [e for e in got.entities if e.startswith("/map/component_0/corridors/")]
    assert len(strands) == 2


def test_run_names_do_not_meet_names_of_ours(tmp_path: Path, merge_of: Merge) -> None:
    names = ["frames", "junctions", "matched", "titles"]
    result, maps = merge_of([names[:2], names[2:]], ambiguous=[("frames", "matched")])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    for run in names:
        assert len(got.value(f"/steps/runs/{run}/junctions", "Points2D:positions")) == 5
    both = "/undecided/pairs/frames/matched/best"
    assert len(got.value(f"{both}/matched", "Points2D:positions")) == 5
    assert len(got.value(f"{both}/b/matched/junctions", "Points2D:positions")) == 5


def test_a_single_run_and_no_run_are_written(
    tmp_path: Path, merge_of: Merge, no_fused: FusedMap
) -> None:
    result, maps = merge_of([["only"]])
    write_merged_recording(tmp_path / "one.rrd", result, maps)
    assert "/map/component_0/junctions" in Readback(tmp_path / "one.rrd").entities
    nothing = MergeResult((), no_fused, ())
    write_merged_recording(tmp_path / "none.rrd", nothing, [])
    assert Readback(tmp_path / "none.rrd").blueprints == 1


def test_a_run_that_met_no_junction_has_a_place(
    tmp_path: Path, merge_of: Merge, empty_map: TopoMap
) -> None:
    result, maps = merge_of([["a"]])
    lonely = Component(1, {empty_map.run: np.zeros(3)})
    both = MergeResult((*result.components, lonely), result.fused, ())
    write_merged_recording(tmp_path / "merged.rrd", both, [*maps, empty_map])
    got = Readback(tmp_path / "merged.rrd")
    assert got.value("/map/titles", "Points2D:labels") == ["a", "nowhere"]


def test_maps_in_any_order_give_the_same_recording(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b"], ["c"]], ambiguous=[("a", "c")])
    write_merged_recording(tmp_path / "one.rrd", result, maps)
    write_merged_recording(tmp_path / "two.rrd", result, maps[::-1])
    assert Readback(tmp_path / "one.rrd").content() == Readback(tmp_path / "two.rrd").content()


def test_missing_and_double_maps_are_refused(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b"]])
    with pytest.raises(ValueError, match="'b' is missing"):
        write_merged_recording(tmp_path / "m.rrd", result, maps[:1])
    with pytest.raises(ValueError, match="same run name"):
        write_merged_recording(tmp_path / "m.rrd", result, [*maps, maps[0]])
    assert list(tmp_path.iterdir()) == []
