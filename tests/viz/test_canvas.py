import xml.etree.ElementTree as ET
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from topobatch.viz.canvas import SMALL_PT, Canvas, Key, fitting, folded, round_length, width_of
from topobatch.viz.palette import DARK, LIGHT

SVG = "{http://www.w3.org/2000/svg}"
HOSTILE = '<script>alert("1")</script> & $x_1$ --> _private \u202e\x1b[2J'


def canvas(theme=LIGHT, name: str = HOSTILE) -> Canvas:
    drawn = Canvas(np.array([0.0, 0.0]), np.array([40.0, 20.0]), theme)
    drawn.lines([np.array([(0.0, 0.0), (40.0, 20.0)])], theme.run(0), 2.0, told=name)
    drawn.dots(np.array([(1.23456789, 2.0)]), theme["ink"], 4.0, told="a dot")
    drawn.words((5.0, 5.0), name)
    drawn.finish([name], [[Key("title", theme["ink"], "runs"), Key("line", theme.run(0), name)]])
    return drawn


def words(svg: bytes) -> list[str]:
    return ["".join(node.itertext()) for node in ET.fromstring(svg).iter(f"{SVG}text")]


def test_the_same_drawing_is_the_same_bytes() -> None:
    for form in ("svg", "png"):
        assert canvas().as_bytes(form) == canvas().as_bytes(form)
    drawn = canvas()
    assert drawn.as_bytes("svg") == drawn.as_bytes("svg")
    assert canvas(DARK).as_bytes("svg") != canvas().as_bytes("svg")
    assert b"date" not in canvas(name="plain").as_bytes("svg")


def test_names_are_shown_as_text_and_nothing_else() -> None:
    svg = canvas().as_bytes("svg")
    shown = HOSTILE.replace("\u202e", "\ufffd").replace("\x1b", "\ufffd")
    assert words(svg).count(shown) >= 2  # in the drawing and above it
    root = ET.fromstring(svg)
    assert not list(root.iter(f"{SVG}script"))
    titles = [node.text for node in root.iter(f"{SVG}title")]
    assert titles == [shown, "a dot"]


def test_coordinates_have_no_more_digits_than_show() -> None:
    for node in ET.fromstring(canvas().as_bytes("svg")).iter():
        for name in ("d", "x", "y", "transform"):
            for number in node.get(name, "").replace(",", " ").split():
                assert len(number.rstrip(")").partition(".")[2]) <= 2, number


def test_a_picture_of_dots_has_its_size() -> None:
    with Image.open(BytesIO(canvas().as_bytes("png"))) as image:
        assert image.width == 1500
        assert image.info["Software"] == "topobatch"


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_many_runs_have_many_colours(theme) -> None:
    assert len({theme.run(k) for k in range(40)}) == 40


def test_names_that_do_not_fit_are_shortened_in_the_middle() -> None:
    assert fitting("run 1", 100.0, SMALL_PT) == "run 1"
    short = fitting("a" * 50 + "b" * 50, 100.0, SMALL_PT)
    assert short[0] == "a"
    assert "…" in short
    assert short[-1] == "b"
    assert width_of(short, SMALL_PT) <= 100.0
    assert fitting("run 1", 2.0, SMALL_PT) == ""
    wide = fitting("走行" * 30, 100.0, SMALL_PT)
    assert width_of(wide, SMALL_PT) <= 100.0


def test_long_labels_of_a_legend_stand_in_two_columns() -> None:
    def height(labels: int) -> float:
        drawn = Canvas(np.array([0.0, 0.0]), np.array([40.0, 20.0]), LIGHT)
        drawn.finish([], [[Key("line", LIGHT.run(k), f"{k} " * 300) for k in range(labels)]])
        return float(drawn.figure.get_figheight()) * 72.0

    assert height(2) == height(1)
    assert height(3) == height(4) > height(2)


def test_text_is_folded_into_lines() -> None:
    lines = folded("one two three four five six seven", 60.0, SMALL_PT)
    assert len(lines) > 1
    assert " ".join(lines) == "one two three four five six seven"
    assert folded("", 60.0, SMALL_PT) == []


@pytest.mark.parametrize(("most", "bar"), [(7.0, 5.0), (1.0, 1.0), (23.0, 20.0), (0.34, 0.2)])
def test_the_scale_bar_has_a_round_length(most: float, bar: float) -> None:
    assert round_length(most) == pytest.approx(bar)
