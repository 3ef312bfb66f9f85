import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.decision import Placement, Term
from topobatch.merge.decision_text import lines
from topobatch.merge.result import Alignment, Verdict
from topobatch.topology.turning_points import TURNING_POINT
from topobatch.viz.draw import (
    draw_decision,
    draw_map,
    draw_merged,
    draw_site,
)
from topobatch.viz.palette import DARK, LIGHT

from ..topology.floors import floor, views_at
from .test_decision_recording import decision, placement, with_views

SVG = "{http://www.w3.org/2000/svg}"


def seen(canvas) -> tuple[list[str], list[str]]:
    """What is written in a drawing, and what its parts say when pointed at."""
    root = ET.fromstring(canvas.as_bytes("svg"))
    texts = ["".join(node.itertext()) for node in root.iter(f"{SVG}text")]
    return texts, [node.text or "" for node in root.iter(f"{SVG}title")]


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_a_map_shows_and_tells_its_junctions_and_corridors(make_map, theme) -> None:
    texts, titles = seen(draw_map(make_map("run"), theme))
    assert {"run", "5 junctions, 5 corridors, 38 m; 8 passes", *"01234"} <= set(texts)
    assert "corridor 0 to 1: 10.00 ± 0.10 m, driven 2 times" in titles
    assert "dead end 4: 1 pass" in titles
    keys = {
        "corridor",
        "driven more often",
        "branch never driven",
        "dead end",
        "bend",
        "3 branches",
    }
    assert keys <= set(texts)
    assert "4 branches" not in texts  # there is none
    assert any(t.endswith(" m") and t[0].isdigit() for t in texts)  # the scale


def test_ways_to_turning_points_are_drawn_and_are_no_corridors(make_map, turned, merge_of) -> None:
    texts, titles = seen(draw_map(turned(make_map("run")), LIGHT))
    ways = "1 way to turning points or ends of the log, 6 m"
    assert {
        "run",
        f"4 junctions, 4 corridors, 32 m, {ways}; 7 passes",
        "robot turned round",
    } <= set(texts)
    assert "robot turned round, 6.00 m from junction 2" in titles
    result, _ = merge_of([["a", "b"]])
    fused = replace(result.fused, kind=(*result.fused.kind[:4], TURNING_POINT))
    texts, _ = seen(draw_merged(replace(result, fused=fused), LIGHT))
    assert f"4 junctions, 32 m of corridors, {ways}; 1 pair of 1 merged" in texts


def test_maps_of_nothing_and_of_one_junction_can_be_drawn(empty_map, one_vertex) -> None:
    texts, _ = seen(draw_map(empty_map, LIGHT))
    assert "0 junctions, 0 corridors, 0 m; 0 passes" in texts
    assert "corridor" not in texts
    texts, titles = seen(draw_map(one_vertex, LIGHT))
    assert titles == ["bend 0: 1 pass"]


def test_a_merge_names_its_runs_in_their_colours(merge_of) -> None:
    result, _ = merge_of([["a", "b"], ["lone"]])
    texts, titles = seen(draw_merged(result, LIGHT))
    assert {"3 runs of 2 sites", "a", "b", "lone", "run that is merged with none"} <= set(texts)
    assert set(titles) == {"a", "b", "lone"}
    svg = draw_merged(result, LIGHT).as_bytes("svg").decode()
    assert LIGHT.run(0) in svg
    assert LIGHT.run(1) in svg
    texts, _ = seen(draw_merged(merge_of([["a", "b"]])[0], LIGHT))
    assert "run that is merged with none" not in texts
    assert "junction seen by one run" not in texts


@pytest.mark.parametrize("count", [1, 20])
def test_the_legend_holds_every_merged_run(merge_of, count: int) -> None:
    groups = [[f"site{g}-{k:03d}" for k in range(10)] for g in range(count // 10)] or [["one"]]
    texts, _ = seen(draw_merged(merge_of(groups)[0], DARK))
    assert {run for group in groups for run in group if count > 1} <= set(texts)
    assert ("component 1" in texts) == (count > 10)


def test_a_site_is_drawn_with_the_numbers_of_its_junctions(merge_of) -> None:
    result, _ = merge_of([["a"], ["b", "c"]])
    texts, _ = seen(draw_site(result, 1, LIGHT))
    assert {"5", "6", "7", "8", "9"} <= set(texts)
    assert not {"0", "4", "a"} & set(texts)


def test_a_merged_pair_is_tied_junction_by_junction(make_map) -> None:
    told = decision(Verdict.MERGED, [placement(30.0)])
    a, b = make_map("a/1"), make_map("b", (1.0, 2.0, 0.4))
    texts, titles = seen(draw_decision(a, b, told, LIGHT))
    assert "a/1 and b: merged: 30.0 bits of evidence, 12.6 needed" in texts
    assert {"placement: 30.0 bits", "the 5 matched junctions tied"} <= set(texts)
    assert {f"junction {k} = junction {k}" for k in range(5)} <= set(titles)
    assert "+29.0 bits: corridor" in titles
    assert "-2.0 bits: junction unseen in a corridor" in titles
    assert {"matched junctions, tied", "link that speaks for it", "what speaks against it"} <= set(
        texts
    )


def test_links_of_a_pair_read_as_explain_shows_them(make_map) -> None:
    terms = [Term("corridor", 1.74, "corridor", ends, ends) for ends in ((0, 1), (1, 2))]
    at = Alignment(np.array([1.0, 2.0, 0.3]), 3.48, np.array([[0, 0], [1, 1], [2, 2]]), 0.1, 2)
    told = decision(Verdict.AMBIGUOUS, [Placement(at, tuple(terms))])
    explained = [line.split()[0] for line in lines(told) if line.rstrip().endswith(("0-1", "1-2"))]
    assert explained == ["+1.8", "+1.7"]
    _, titles = seen(draw_decision(make_map("a"), make_map("b"), told, LIGHT))
    drawn = [t.split()[0] for t in titles if t.endswith("bits: corridor")]
    assert list(dict.fromkeys(drawn)) == explained


def test_an_ambiguous_pair_shows_both_placements(make_map) -> None:
    told = decision(Verdict.AMBIGUOUS, [placement(9.0), placement(8.0)])
    a, b = make_map("a"), make_map("b", (1.0, 2.0, 0.4))
    texts, _ = seen(draw_decision(a, b, told, LIGHT))
    assert {"placement: 9.0 bits", "next best: 8.0 bits"} <= set(texts)


def test_what_has_changed_since_the_merge_stands_in_the_drawing_of_a_pair(make_map) -> None:
    merged = decision(Verdict.MERGED, [placement(30.0)])
    for plain in (merged, decision(Verdict.UNRELATED, [])):
        told = replace(plain, notes=("not merged yet", "merge again"))
        texts, _ = seen(draw_decision(make_map("a"), make_map("b"), told, LIGHT))
        assert {"Note: not merged yet", "Note: merge again"} <= set(texts)


def test_a_pair_with_nothing_alike_is_drawn_side_by_side(make_map) -> None:
    told = decision(Verdict.UNRELATED, [])
    texts, _ = seen(draw_decision(make_map("a/1"), make_map("b"), told, LIGHT))
    assert {"a/1", "b"} <= set(texts)
    assert "matched junctions, tied" not in texts


def test_walls_lie_under_the_map_where_views_show_them(make_map, merge_of) -> None:
    views = views_at(floor(1), [(20.0, 20.0, 0.2), (26.0, 20.0, 0.0)])
    shown = replace(make_map("run"), views=replace(views, pose=views.pose - (20.0, 20.0, 0.0)))
    plain = draw_map(make_map("run"), LIGHT).as_bytes("svg")
    assert b"wall" not in plain
    texts, _ = seen(draw_map(shown, LIGHT))
    assert "wall" in texts
    drawn = draw_map(shown, LIGHT).as_bytes("svg")
    assert LIGHT["wall"].encode() in drawn
    assert 2_000 < len(drawn) - len(plain) < 50_000
    result, maps = merge_of([["a", "b"]])
    walled = {m.run: replace(m, views=shown.views) for m in maps[:1]}
    assert "wall" in seen(draw_site(result, 0, LIGHT, walled))[0]
    assert "wall" not in seen(draw_site(result, 0, LIGHT))[0]


def test_views_are_drawn_beside_the_placement_that_they_speak_for(make_map) -> None:
    told = decision(Verdict.MERGED, [with_views(placement(30.0))])
    texts, _ = seen(draw_decision(make_map("a/1"), make_map("b"), told, LIGHT))
    assert {"views for it: +3.0 bits", "views against it: -2.5 bits"} <= set(texts)
