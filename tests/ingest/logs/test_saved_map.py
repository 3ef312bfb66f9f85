"""Maps that map_server saved: a description and a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from topobatch.ingest.grid_log import GridLog
from topobatch.ingest.logs import saved_map
from topobatch.ingest.logs.saved_map import coarser, is_saved_map, read_saved_map
from topobatch.ingest.mapping import map_of_log
from topobatch.ingest.mapping_settings import MappingSettings
from topobatch.ingest.reading import find_logs, inspect_log, log_fingerprint, read_log
from topobatch.topology.errors import DataError, LogError

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
    grid = read_saved_map(path).grid
    assert grid.free.tolist() == [free]


def test_png_with_alpha_block_lists_and_quotes(tmp_path: Path) -> None:
    pixels = np.array([[[255, 255], [255, 0]]], np.uint8)
    Image.fromarray(pixels, "LA").save(tmp_path / "a.png")
    (tmp_path / "x.yml").write_text(
        "# saved\nimage: 'a.png'  # here\nresolution: 1.0e-1\norigin:\n- 1\n- -2.5\n- 0.5\n"
        "mode: scale\n"
    )
    grid = read_saved_map(tmp_path / "x.yml").grid
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
    for size, why in ((5000, "no picture"), (10_000, "no picture"), (60_000, "too large")):
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


@pytest.mark.parametrize("thresh", [0.2, 0.25, 0.5])
@pytest.mark.parametrize("name", ["m.pgm", "m.jpg"])
def test_unknown_cells_stay_unknown_by_a_threshold_that_takes_them_for_free(
    tmp_path: Path, thresh: float, name: str
) -> None:
    """As nav2's map_saver wrote them."""
    text = FLAT.replace("m.pgm", name)
    right = read_saved_map(saved(tmp_path, hall(), text + "free_thresh: 0.196\n", name)).grid
    path = saved(tmp_path, hall(), text + f"free_thresh: {thresh}\n", name)
    grid, (note,) = read_saved_map(path)
    assert np.array_equal(grid.free, right.free)
    assert np.array_equal(grid.unknown, right.unknown)
    assert f"would be free by its free_thresh of {thresh}; they stay unknown" in note
    assert note in read_log(path).warnings
    assert inspect_log(path).warnings == (note,)


@pytest.mark.parametrize(
    "pixels",
    [np.where(hall() == 254, 205, 0), np.arange(256)[None].repeat(9, 0), np.where(hall(), 230, 0)],
    ids=["nothing brighter", "a gradient", "no such shade"],
)
def test_a_threshold_counts_where_shade_205_is_no_unknown_level(
    tmp_path: Path, pixels: np.ndarray
) -> None:
    grid, notes = read_saved_map(saved(tmp_path, pixels, FLAT + "free_thresh: 0.25\n"))
    assert notes == ()
    assert np.array_equal(grid.free[::-1], 255 - pixels < 0.25 * 255)


@pytest.mark.parametrize(
    "named",
    ["/home/robot/maps/m.pgm", "'C:\\Users\\x\\m.pgm'", "maps/m.pgm", "package://site/m.pgm"],
)
def test_a_picture_of_another_computer_is_found_beside_the_description(
    tmp_path: Path, named: str
) -> None:
    grid, (note,) = read_saved_map(saved(tmp_path, [[254, 0]], FLAT.replace("m.pgm", named)))
    assert grid.free.tolist() == [[True, False]]
    assert "is not there; m.pgm beside it is read" in note


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
def test_photos_are_maps(tmp_path: Path, mode: str) -> None:
    picture = Image.fromarray(hall()).convert("L" if mode == "L" else "RGB").convert(mode)
    picture.save(tmp_path / "m.jpeg", quality=95)
    (tmp_path / "map.yaml").write_text(FLAT.replace("m.pgm", "m.jpeg"))
    grid = read_saved_map(tmp_path / "map.yaml").grid
    assert (grid.free[::-1] != (hall() == 254)).mean() < 0.03


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_pictures_of_16_bits_may_hold_fewer(tmp_path: Path, bits: int) -> None:
    values = np.array([[254, 205, 0]]) * ((1 << bits) - 1) // 255
    Image.fromarray(values.astype(np.uint16)).save(tmp_path / "m.png")
    (tmp_path / "map.yaml").write_text(FLAT.replace("m.pgm", "m.png"))
    grid, notes = read_saved_map(tmp_path / "map.yaml")
    assert grid.free.tolist() == [[True, False, False]]
    assert [f"read as {bits} bits" in note for note in notes] == [True] * (bits < 16)


def test_a_map_without_free_cells_says_what_its_shades_are(tmp_path: Path) -> None:
    path = saved(tmp_path, [[1, 0, 1]])
    assert "shades go from 0 to 1 (0 black, 255 white)" in read_saved_map(path).notes[0]


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (1, 1)])
def test_a_map_of_one_row_says_that_it_shows_no_junction(
    tmp_path: Path, shape: tuple[int, int]
) -> None:
    with pytest.raises(DataError, match="shows no junction"):
        map_of_log(read_log(saved(tmp_path, np.full(shape, 254))), MappingSettings())


@pytest.mark.parametrize("form", ["pgm", "png", "jpg"])
def test_large_pictures_are_read_in_larger_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    """A larger cell is free if all its parts are, unknown if any is; the origin stays."""
    pixels = np.kron(hall(), np.ones((8, 8), np.uint8))[:-3, :-5]
    text = FLAT.replace("m.pgm", f"m.{form}")
    whole = read_saved_map(saved(tmp_path, pixels, text, f"m.{form}")).grid
    monkeypatch.setattr(saved_map, "MOST_CELLS", 60_000)
    monkeypatch.setattr(saved_map, "STRIPE_CELLS", 9_000)
    grid, (note,) = read_saved_map(tmp_path / "map.yaml")
    right = coarser(whole, 3)
    assert np.array_equal(grid.free, right.free)
    assert np.array_equal(grid.unknown, right.unknown)
    assert (grid.resolution_m, grid.origin) == (pytest.approx(0.15), whole.origin)
    assert "is read in cells of 0.15 m" in note


def test_a_picture_beyond_memory_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(saved_map, "MOST_PICTURE_BYTES", 10_000)
    path = saved(tmp_path, hall()[:, :, None].repeat(3, 2), FLAT.replace("m.pgm", "m.png"), "m.png")
    with pytest.raises(
        LogError, match="too large: 2,500 pixels; in shades of grey it may be larger"
    ):
        read_saved_map(path)
    saved(tmp_path, hall())
    assert read_saved_map(path).grid.free.any()


def test_the_fingerprint_follows_the_picture(tmp_path: Path) -> None:
    path = saved(tmp_path, [[254, 0]])
    before = log_fingerprint(path)
    saved(tmp_path, [[254, 254]])
    assert log_fingerprint(path) != before


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
