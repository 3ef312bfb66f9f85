import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest

from topobatch.viz.draw import draw_map, draw_merged
from topobatch.viz.palette import DARK, LIGHT

from ..topology.floors import floor, views_at

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
        "corridor, driven more often",
        "branch never driven",
        "dead end",
        "bend",
        "3 branches",
    }
    assert keys <= set(texts)
    assert "4 branches" not in texts  # there is none
    assert any(t.endswith(" m") and t[0].isdigit() for t in texts)  # the scale


def test_the_axes_of_the_frame_are_drawn_wherever_its_origin_lies(make_map) -> None:
    for away_m, key in ((1.0, "axes of the frame, at its origin"), (99.0, "out of sight")):
        texts, _ = seen(draw_map(make_map("run", (-away_m, -1.0, 0.3)), LIGHT))
        assert {"x", "y"} <= set(texts)
        assert any(key in text for text in texts)


def test_rooms_and_doors_have_marks_and_names_of_their_own(make_map, merge_of) -> None:
    kind = ("room", "door", "junction", "bend", "dead_end")
    texts, _ = seen(draw_map(replace(make_map("run"), kind=kind), LIGHT))
    assert {"room", "door", "3 branches", "bend", "dead end"} <= set(texts)
    assert any(text.startswith("3 junctions, 1 room, 1 door, ") for text in texts)
    result, _ = merge_of([["a", "b"]])
    home = replace(result, fused=replace(result.fused, kind=kind))
    texts, _ = seen(draw_merged(home, LIGHT))
    assert {f"{what} seen by several runs" for what in ("room", "door", "junction")} <= set(texts)


def test_maps_of_nothing_and_of_one_junction_can_be_drawn(empty_map, one_vertex) -> None:
    texts, _ = seen(draw_map(empty_map, LIGHT))
    assert "0 junctions, 0 corridors, 0 m" in texts
    assert "corridor" not in texts
    texts, titles = seen(draw_map(one_vertex, LIGHT))
    assert titles == ["bend 0: 1 pass"]


def test_a_merge_names_its_runs_in_their_colours(merge_of) -> None:
    result, _ = merge_of([["a", "b"], ["lone"]])
    texts, titles = seen(draw_merged(result, LIGHT))
    assert {"3 runs: 1 site, 1 run alone", "a", "b", "run that is merged with none"} <= set(texts)
    assert "lone" in texts
    assert set(titles) == {"a", "b", "lone"}
    svg = draw_merged(result, LIGHT).as_bytes("svg").decode()
    assert LIGHT.run(0) in svg
    assert LIGHT.run(1) in svg
    texts, _ = seen(draw_merged(merge_of([["a", "b"]])[0], LIGHT))
    assert "run that is merged with none" not in texts
    assert "junction seen by one run" not in texts


def test_a_site_is_drawn_with_the_numbers_of_its_junctions(merge_of) -> None:
    result, _ = merge_of([["a"], ["b", "c"]])
    texts, _ = seen(draw_merged(result, LIGHT, sites=[1]))
    assert {"5", "6", "7", "8", "9"} <= set(texts)
    assert not {"0", "4", "a"} & set(texts)


def test_where_numbers_have_no_room_pointing_tells_them(merge_of, monkeypatch) -> None:
    monkeypatch.setattr("topobatch.viz.draw.MOST_NUMBERED", 4)
    texts, titles = seen(draw_merged(merge_of([["a"], ["b", "c"]])[0], LIGHT, sites=[1]))
    assert {f"Junction {k}" for k in range(5, 10)} <= {
        title.split(":")[0].split(" (")[0] for title in titles
    }
    assert any("point at one" in text for text in texts)
    assert "5" not in texts
    texts, _ = seen(draw_merged(merge_of([["a"], ["b", "c"]])[0], LIGHT, sites=[0, 1], drives=[]))
    assert {"0", "5"} <= set(texts)  # have branches that nobody drove
    assert "4" not in texts


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
    assert "wall" in seen(draw_merged(result, LIGHT, sites=[0], maps=walled))[0]
    assert "wall" not in seen(draw_merged(result, LIGHT, sites=[0]))[0]
