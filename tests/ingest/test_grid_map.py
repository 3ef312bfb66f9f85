"""Saved maps: read as map_server reads them, hostile ones refused, drawn as junctions and ways."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from topobatch.ingest.grid_log import GridLog
from topobatch.ingest.grid_map import map_of_grid
from topobatch.ingest.logs.grids import grid_of_message
from topobatch.ingest.logs.messages import Channel, DamageError
from topobatch.ingest.logs.saved_map import Grid, is_saved_map, read_saved_map
from topobatch.ingest.reading import find_logs, inspect_log, log_fingerprint, read_log
from topobatch.merge.merging import merge_maps
from topobatch.simulation import World, make_world
from topobatch.simulation.walls import free_space
from topobatch.simulation.world import polyline_at
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.errors import DataError, LogError
from topobatch.topology.se2 import apply, fit_rigid
from topobatch.topology.topomap import TopoMap

FLAT = "image: m.pgm\nresolution: 0.05\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n"


def saved(folder: Path, pixels: object, text: str = FLAT, name: str = "m.pgm") -> Path:
    Image.fromarray(np.asarray(pixels, np.uint8)).save(folder / name)
    path = folder / "map.yaml"
    path.write_text(text)
    return path


def test_a_saved_map_is_read_as_map_server_does(tmp_path: Path) -> None:
    grid = read_saved_map(saved(tmp_path, [[254, 205, 0], [0, 254, 254]]))
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
        ("negate: 1\n", [False, False, True]),
        ("free_thresh: 0.5\n", [True, True, False]),
        ("free_thresh: 0.001\n", [False, False, False]),
        ("mode: scale\n", [True, False, False]),
        ("mode: raw\nfree_thresh: 0.25\n", [False, False, True]),
    ],
)
def test_thresholds_and_modes(tmp_path: Path, lines: str, free: list[bool]) -> None:
    grid = read_saved_map(saved(tmp_path, [[254, 205, 0]], FLAT.replace("negate: 0\n", "") + lines))
    assert grid.free.tolist() == [free]


def test_png_with_alpha_block_lists_and_quotes(tmp_path: Path) -> None:
    pixels = np.array([[[255, 255], [255, 0]]], np.uint8)
    Image.fromarray(pixels, "LA").save(tmp_path / "a.png")
    (tmp_path / "x.yml").write_text(
        "# saved\nimage: 'a.png'  # here\nresolution: 1.0e-1\norigin:\n- 1\n- -2.5\n- 0.5\n"
        "mode: scale\n"
    )
    grid = read_saved_map(tmp_path / "x.yml")
    assert grid.free.tolist() == [[True, False]]
    assert (grid.resolution_m, grid.origin) == (0.1, (1.0, -2.5, 0.5))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("m.pgm", "gone.pgm"), "is missing"),
        (("m.pgm", "../../etc/passwd\x00"), "is missing"),
        (("0.05", "0"), "resolution"),
        (("0.05", "nan"), "resolution"),
        (("0.05", "wide"), "could not convert"),
        (("-1.0", "1e99"), "no place"),
        (("negate: 0", "mode: odd"), "mode"),
        (("-1.0, 2.0, 0.0", ""), "could not convert"),
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
    for size in (5000, 10_000, 60_000):
        picture.write_bytes(f"P5 {size} {size} 255\n".encode() + bytes(100))
        with pytest.raises(LogError, match=r"too large|no picture"):
            read_log(path)
    (tmp_path / "long.yaml").write_text(FLAT + "#" * 70_000)
    assert not is_saved_map(tmp_path / "long.yaml")


def test_the_fingerprint_follows_the_picture(tmp_path: Path) -> None:
    path = saved(tmp_path, [[254, 0]])
    before = log_fingerprint(path)
    saved(tmp_path, [[254, 254]])
    assert log_fingerprint(path) != before


# --- maps --------------------------------------------------------------------------------------


def grid_of(world: World, seen: set[int] | None = None, resolution: float = 0.05) -> Grid:
    """What a perfect mapper would save of a world, or of what is seen from some vertices of it:
    their junctions, and the corridors there half-way to the next ones.
    """
    polygons = free_space(world, 1.4)
    low = np.min([p.min(axis=0) for p in polygons], axis=0) - 1
    high = np.max([p.max(axis=0) for p in polygons], axis=0) + 1
    width, height = np.ceil((high - low) / resolution).astype(int).tolist()
    picture = Image.new("L", (width, height), 0)
    pen = ImageDraw.Draw(picture)
    for polygon in polygons:
        pen.polygon([tuple(p) for p in (polygon - low) / resolution], fill=1)
    free = np.asarray(picture) > 0
    walls = binary_dilation(free, iterations=3) & ~free
    if seen is not None:
        rows = np.argwhere(free)
        ways = [
            polyline_at(p, np.linspace(0, n, 50))
            for p, n in zip(world.paths, world.length, strict=True)
        ]
        owner = np.concatenate(
            [
                np.repeat([int(world.source[e]), int(world.target[e])], 25)
                for e in range(len(world.source))
            ]
        )
        _, nearest = cKDTree(np.concatenate(ways)).query(rows[:, ::-1] * resolution + low)
        kept = np.isin(owner[nearest], sorted(seen))
        free = np.zeros_like(free)
        free[tuple(rows[kept].T)] = True
        walls &= binary_dilation(free, iterations=5)
    return Grid(free, ~free & ~walls, resolution, (float(low[0]), float(low[1]), 0.0))


def topomap(name: str, grid: Grid) -> TopoMap:
    found = map_of_grid(GridLog(name, grid, {"junctions": {"from": "grid", "topic": name}}))
    return map_from_document(map_to_document(found))


@pytest.mark.parametrize("kind", ["maze", "office", "organic", "city"])
def test_a_grid_shows_the_junctions_of_its_world(kind: str) -> None:
    world = make_world(kind, 40, 5)
    found = topomap(kind, grid_of(world))
    there = np.flatnonzero(world.branches.counts >= 3)
    gap = np.hypot(*(found.xy[:, None] - world.xy[there][None]).transpose(2, 0, 1))
    seen = gap.min(axis=0) < 1.0
    assert seen.mean() >= 0.95, f"{seen.sum()} of {len(there)}"
    of_junctions = np.array([k == "junction" for k in found.kind])
    right = gap[of_junctions].min(axis=1) < 1.0
    # Where streets part at an acute angle, the free space between them makes nodes of its own.
    least = 0.9 if kind == "organic" else 0.95
    assert right.mean() >= least, f"{right.sum()} of {of_junctions.sum()}"
    degree = world.branches.counts[there][gap.argmin(axis=1)]
    right = (found.degree == degree)[of_junctions]
    assert right.mean() >= (0.85 if kind == "organic" else 0.95), f"{right.sum()} of {len(right)}"


def test_lengths_are_those_of_the_corridors() -> None:
    world = make_world("maze", 30, 8)
    found = topomap("maze", grid_of(world))
    chord = np.hypot(*(found.xy[found.source] - found.xy[found.target]).T)
    assert np.all(found.length >= chord - 1e-9)
    straight = found.length < 1.02 * chord
    assert straight.mean() > 0.3
    for path, source, target in zip(found.paths, found.source, found.target, strict=True):
        np.testing.assert_allclose(path[[0, -1]], found.xy[[source, target]])


def turned(grid: Grid) -> Grid:
    free, unknown = np.rot90(grid.free), np.rot90(grid.unknown)
    return Grid(free, unknown, grid.resolution_m, (3.0, 4.0, 0.7))


@pytest.mark.parametrize("kind", ["maze", "organic", "city"])
def test_two_halves_of_a_world_merge_and_strangers_do_not(kind: str) -> None:
    world = make_world(kind, 60, 5)
    order = np.argsort(world.xy[:, 0])
    left, right = (
        set(part.tolist()) for part in (order[: len(order) * 2 // 3], order[len(order) // 3 :])
    )
    maps = [topomap("left", grid_of(world, left)), topomap("right", turned(grid_of(world, right)))]
    maps += [topomap(f"other{k}", grid_of(make_world(kind, 40, 100 + k))) for k in range(3)]
    result = merge_maps(maps)
    verdicts = {(p.a, p.b): p.verdict for p in result.verdicts}
    assert verdicts.pop(("left", "right")) == "merged"
    assert set(verdicts.values()) <= {"unrelated", "ambiguous"}


def test_a_grid_without_junctions(tmp_path: Path) -> None:
    corridor = np.zeros((20, 200), bool)
    corridor[5:15, 5:195] = True
    for free in (corridor, np.zeros((5, 5), bool)):
        with pytest.raises(DataError, match="shows no junction"):
            map_of_grid(GridLog("x", Grid(free, ~free, 0.1, (0.0, 0.0, 0.0)), {}))


def test_the_origin_places_the_map() -> None:
    grid = grid_of(make_world("maze", 20, 4))
    plain = topomap("a", grid._replace(origin=(0.0, 0.0, 0.0)))
    moved = topomap("a", grid._replace(origin=(5.0, -3.0, 1.0)))
    np.testing.assert_allclose(moved.xy, apply(np.array([5.0, -3.0, 1.0]), plain.xy), atol=2e-3)
    np.testing.assert_allclose(fit_rigid(moved.xy, plain.xy), (5.0, -3.0, 1.0), atol=2e-3)
    np.testing.assert_array_equal(moved.degree, plain.degree)


@settings(
    deadline=None, max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
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


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_any_bytes_are_a_grid_or_damage(sensors: ModuleType, data: st.DataObject) -> None:
    encoding = data.draw(st.sampled_from(["cdr", "ros1"]))
    raw = bytearray(sensors.grid([[0, 100], [-1, 0]], 0.1, (1.0, 2.0, 0.3), encoding))
    for _ in range(data.draw(st.integers(1, 5))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    payload = bytes(raw[: data.draw(st.integers(0, len(raw)))])
    try:
        grid = grid_of_message(Channel("/map", sensors.GRID, encoding), payload)
    except (DamageError, ValueError):
        return
    assert grid.free.shape == grid.unknown.shape
    assert grid.resolution_m > 0
