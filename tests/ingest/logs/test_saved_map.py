"""Maps that map_server saved: a description and a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from topobatch.ingest.logs import saved_map
from topobatch.ingest.logs.grids import GridLog
from topobatch.ingest.logs.saved_map import is_saved_map, read_saved_map
from topobatch.ingest.reading import find_logs, inspect_log, read_log
from topobatch.topology.errors import LogError

FLAT = "image: m.pgm\nresolution: 0.05\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n"


def saved(folder: Path, pixels: object, text: str = FLAT, name: str = "m.pgm") -> Path:
    Image.fromarray(np.asarray(pixels, np.uint8)).save(folder / name)
    path = folder / "map.yaml"
    path.write_text(text)
    return path


def test_a_saved_map_is_read_as_map_server_does(tmp_path: Path) -> None:
    grid, notes = read_saved_map(saved(tmp_path, [[254, 205, 0], [0, 254, 254]]))
    assert notes == ()
    # The first row of a picture is the one with the largest y.
    assert grid.free.tolist() == [[False, True, True], [True, False, False]]
    assert (grid.resolution_m, grid.origin) == (0.05, (-1.0, 2.0, 0.0))
    assert is_saved_map(tmp_path / "map.yaml")
    assert find_logs([tmp_path]) == [tmp_path / "map.yaml"]
    info = inspect_log(tmp_path / "map.yaml")
    assert info.problems == ()
    assert "3 x 2 cells" in info.topics[0].why


@pytest.mark.parametrize(
    ("lines", "free"),
    [
        *((f"negate: {word}\n", [False, False, True]) for word in ("1", "true", "Yes", "'on'")),
        *((f"negate: {word}\n", [True, False, False]) for word in ("0", "false", "No", "OFF")),
        ("free_thresh: 0.5\n", [True, False, False]),
        ("free_thresh: 0.001\n", [False, False, False]),
        ("mode: scale\n", [True, False, False]),
        ("mode: raw\nfree_thresh: 0.25\n", [False, False, True]),
    ],
)
def test_thresholds_and_modes(tmp_path: Path, lines: str, free: list[bool]) -> None:
    path = saved(tmp_path, [[254, 205, 0]], FLAT.replace("negate: 0\n", "") + lines)
    grid = read_saved_map(path)[0]
    assert grid.free.tolist() == [free]


def test_png_with_alpha_block_lists_and_quotes(tmp_path: Path) -> None:
    pixels = np.array([[[255, 255], [255, 0]]], np.uint8)
    Image.fromarray(pixels, "LA").save(tmp_path / "a.png")
    (tmp_path / "x.yml").write_text(
        "# saved\nimage: 'a.png'  # here\nresolution: 1.0e-1\norigin:\n- 1\n- -2.5\n- 0.5\n"
        "mode: scale\n"
    )
    grid = read_saved_map(tmp_path / "x.yml")[0]
    assert grid.free.tolist() == [[True, False]]
    assert (grid.resolution_m, grid.origin) == (0.1, (1.0, -2.5, 0.5))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("m.pgm", "gone.pgm"), "is missing"),
        (("m.pgm", "../../etc/passwd\x00"), "is missing"),
        (("0.05", "0"), "resolution"),
        (("0.05", "nan"), "resolution"),
        (("0.05", "wide"), "its resolution is 'wide', not a number"),
        (("negate: 0", "negate: maybe"), "its negate is 'maybe', not a number"),
        (("-1.0", "1e99"), "no place"),
        (("negate: 0", "mode: odd"), "mode"),
        (("-1.0, 2.0, 0.0", ""), "its origin is not x, y and yaw"),
    ],
)
def test_descriptions_that_are_wrong(tmp_path: Path, change: tuple[str, str], why: str) -> None:
    path = saved(tmp_path, [[254, 0]], FLAT.replace(*change))
    with pytest.raises(LogError, match=why):
        read_log(path)


def test_pictures_that_are_none_or_too_large(tmp_path: Path) -> None:
    path = saved(tmp_path, [[254, 0]])
    picture = tmp_path / "m.pgm"
    for raw in (b"", b"P5", b"P5\n9 9\n255\n\x00", b"GIF89a" + bytes(90), b"P5 -1 5 255 x"):
        picture.write_bytes(raw)
        with pytest.raises(LogError, match=r"no picture|cannot be read|no map"):
            read_log(path)
    for size, why in ((5000, "no picture"), (8_000, "no picture"), (60_000, "too large")):
        picture.write_bytes(f"P5 {size} {size} 255\n".encode() + bytes(100))
        with pytest.raises(LogError, match=why):
            read_log(path)
    Image.new("L", (3, 3)).save(tmp_path / "m.gif")
    (tmp_path / "map.yaml").write_text(FLAT.replace("m.pgm", "m.gif"))
    with pytest.raises(LogError, match="PGM, PNG, BMP or JPEG"):
        read_log(path)
    (tmp_path / "long.yaml").write_text(FLAT + "#" * 70_000)
    assert not is_saved_map(tmp_path / "long.yaml")


def hall(width: int = 90, height: int = 60) -> np.ndarray:
    """A corridor and another across it, walls around them, and unknown beyond."""
    pixels = np.full((height, width), 205, np.uint8)
    for value, grow in ((0, 2), (254, 0)):
        pixels[25 - grow : 35 + grow, 10 - grow : 80 + grow] = value
        pixels[10 - grow : 50 + grow, 40 - grow : 50 + grow] = value
    pixels[25:35, 10:80] = 254
    return pixels


def test_a_picture_beyond_memory_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(saved_map, "MOST_PIXELS", 6_000)
    path = saved(tmp_path, hall()[:, :, None].repeat(3, 2), FLAT.replace("m.pgm", "m.png"), "m.png")
    with pytest.raises(
        LogError, match="too large: 3,000 pixels; in shades of grey it may be larger"
    ):
        read_saved_map(path)
    saved(tmp_path, hall())
    assert read_saved_map(path)[0].free.any()


@settings(max_examples=120)
@given(st.data())
def test_any_bytes_are_a_map_or_an_error(tmp_path: Path, data: st.DataObject) -> None:
    """Flipped and cut bytes of a description and of its picture, in every format."""
    suffix = data.draw(st.sampled_from(["pgm", "png", "bmp"]))
    text = FLAT.replace("m.pgm", f"m.{suffix}")
    path = saved(tmp_path, [[254, 205, 0], [0, 254, 254]], text, f"m.{suffix}")
    target = data.draw(st.sampled_from([path, tmp_path / f"m.{suffix}"]))
    raw = bytearray(target.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    target.write_bytes(raw[: data.draw(st.integers(0, len(raw)))])
    try:
        found = read_log(path)
    except LogError:
        return
    assert isinstance(found, GridLog)
    assert found.grid.free.shape == found.grid.unknown.shape
    assert not np.any(found.grid.free & found.grid.unknown)
