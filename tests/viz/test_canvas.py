import xml.etree.ElementTree as ET

import numpy as np

from topobatch.viz.canvas import Canvas
from topobatch.viz.palette import DARK, LIGHT
from topobatch.viz.surface import Look

SVG = "{http://www.w3.org/2000/svg}"
HOSTILE = '<script>alert("1")</script> & $x_1$ --> _private \u202e\x1b[2J'


def canvas(theme=LIGHT, name: str = HOSTILE) -> Canvas:
    drawn = Canvas(np.array([0.0, 0.0]), np.array([40.0, 20.0]), theme)
    drawn.lines(
        [np.array([(0.0, 0.0), (40.0, 20.0)])], Look(theme.run(0), 2.0, tips=[name], key=name)
    )
    drawn.dots(np.array([(1.23456789, 2.0)]), Look(theme["ink"], 4.0, tips=["a dot"]))
    drawn.words(np.array([(5.0, 5.0)]), [name])
    drawn.finish([name])
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


def test_numbers_that_would_lie_over_each_other_are_moved() -> None:
    drawn = Canvas(np.zeros(2), np.array([40.0, 20.0]), LIGHT)
    for k in range(4):
        drawn.words(np.array([(20.0, 10.0 + 0.01 * k)]), [f"12{k}"])
    boxes = np.array(drawn._written)
    apart = (
        np.abs(boxes[:, None, :2] - boxes[None, :, :2]) - boxes[:, None, 2:] - boxes[None, :, 2:]
    )
    assert np.all(apart.max(axis=-1)[~np.eye(4, dtype=bool)] >= 0)
