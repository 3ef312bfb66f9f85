from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.merge.result import FusedMap, MergeResult, PairVerdict
from topobatch.topology.topomap import TopoMap
from topobatch.viz import palette
from topobatch.viz.merged_recording import write_merged_recording

from ..topology.floors import floor, views_at
from .readback import Readback

Merge = Callable[..., tuple[MergeResult, list[TopoMap]]]


def test_a_merge_is_written_and_read_back(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b", "c"], ["d"]], ambiguous=[("c", "d")])
    first, *others = result.verdicts
    result = replace(result, verdicts=(replace(first, evidence_bits=3.846), *others))
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
    numbers = got.value("/verdicts/bits", "Points2D:labels")
    assert numbers[0] == "3.9"  # as reasons and documents have it
    assert "/undecided/pairs/c/d/best/matched" in got.entities
    assert "/undecided/pairs/c/d/runner-up/b/d/corridors" in got.entities
    assert "two ways" in got.value("/pairs", "TextDocument:text")[0]


def test_pairs_that_a_person_locked_are_marked_in_the_matrix(
    tmp_path: Path, merge_of: Merge
) -> None:
    result, maps = merge_of([["a"], ["b"]])
    (pair,) = result.verdicts
    locked = replace(result, verdicts=(replace(pair, evidence_bits=30.0, locked="never"),))
    write_merged_recording(tmp_path / "merged.rrd", locked, maps)
    labels = Readback(tmp_path / "merged.rrd").value("/verdicts/bits", "Points2D:labels")
    assert labels == ["30.0\nlocked"]


def colours_at(got: Readback, entity: str, archetype: str) -> dict[int, list[int]]:
    """The colours of an entity from each step on, as 0xRRGGBBAA."""
    rows = got.rows(entity, f"{archetype}:colors")
    return dict(zip(got.times(entity, "join").tolist(), rows, strict=True))


def rgba(colour: tuple[int, int, int]) -> int:
    red, green, blue = colour
    return red << 24 | green << 16 | blue << 8 | 255


def test_the_first_view_follows_the_merge(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b", "c"], ["lone"]])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    dim = rgba(palette.UNLIT)
    ribbon = "/map/component_0/corridors"
    for rank, (run, step) in enumerate({"a": 1, "b": 1, "c": 2}.items()):
        lit = rgba(palette.of_rank(rank))
        assert colours_at(got, f"{ribbon}/{run}", "LineStrips2D") == {0: [dim], step: [lit]}
    assert colours_at(got, "/map/component_0/junctions", "Points2D") == {
        0: [dim] * 5,
        1: [rgba(palette.WHITE)] * 5,
    }
    # A run that is merged with none is never dim, and has no time.
    lone = got.value("/map/component_1/corridors/lone", "LineStrips2D:colors")
    assert lone == [rgba(palette.SINGLE)]
    assert got.value("/map/joins", "pair") == ["a - b", "a - c"]
    now, past, gone = map(rgba, (palette.WHITE, palette.PAST, palette.BACKGROUND))
    assert colours_at(got, "/map/joins", "LineStrips2D") == {
        0: [gone, gone],
        1: [now, gone],
        2: [past, now],
        3: [past, past],
    }
    assert len(got.rows("/story", "TextDocument:text")) == 3


def test_contradictions_lie_where_they_are(tmp_path: Path, merge_of: Merge) -> None:
    result, maps = merge_of([["a", "b"], ["c"]], ambiguous=[("a", "c")])

    def against(pair: PairVerdict) -> PairVerdict:
        if pair.best is None:
            return pair
        told = ("junction 3 of b is unseen", "corridors cross")
        where = (((0, 1), (3,)), ((0, 1), (1, 2)))
        return replace(pair, best=replace(pair.best, contradictions=told, contradicting=where))

    result = replace(result, verdicts=tuple(map(against, result.verdicts)))
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    entity = "/map/component_0/contradictions"
    at = np.array(got.value(entity, "Points2D:positions"))
    assert at[0] == pytest.approx(result.fused.xy[3], abs=1e-4)
    assert at[1] == pytest.approx(result.fused.xy[[0, 1, 1, 2]].mean(axis=0), abs=1e-4)
    assert got.value(entity, "contradiction") == ["junction 3 of b is unseen", "corridors cross"]
    assert "/undecided/pairs/a/c/best/contradictions" in got.entities
    assert "/undecided/pairs/a/c/runner-up/contradictions" not in got.entities


def test_runs_are_named(tmp_path: Path, merge_of: Merge) -> None:
    half = [f"run {i:03d}" for i in range(10)]
    result, maps = merge_of([half, *([f"x{i}"] for i in range(10))])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    assert got.value("/legend/runs", "Points2D:labels") == ["component 0", *half]
    assert got.value("/verdicts/runs", "run")[: len(half)] == half
    assert got.value("/verdicts/rows", "Points2D:labels") == ["component 0"]
    assert len(got.value("/verdicts/evidence", "pair")) == len(result.verdicts)


def test_many_components_are_laid_side_by_side(tmp_path: Path, merge_of: Merge) -> None:
    names = [f"run {i:02d}" for i in range(30)]
    result, maps = merge_of([[name] for name in names])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    places = [got.value(f"/map/component_{i}", "Transform3D:translation")[0] for i in range(30)]
    assert len({tuple(place) for place in places}) == 30
    assert got.value("/map/titles", "Points2D:labels") == names
    assert "/undecided" not in got.entities
    assert "/story" not in got.entities
    assert "/map/joins" not in got.entities


def test_run_names_do_not_meet_names_of_ours(tmp_path: Path, merge_of: Merge) -> None:
    names = ["frames", "junctions", "matched", "titles"]
    result, maps = merge_of([names[:2], names[2:]], ambiguous=[("frames", "matched")])
    write_merged_recording(tmp_path / "merged.rrd", result, maps)
    got = Readback(tmp_path / "merged.rrd")
    for run in names:
        assert f"/runs/component_{names.index(run) // 2}/{run}/junctions" in got.entities
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
