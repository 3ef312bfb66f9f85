"""`topobatch export --format grid`: what it makes of scans, views and saved maps."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from topobatch.cli.workspace import Workspace
from topobatch.ingest.logs.saved_map import read_saved_map
from topobatch.simulation.worlds import make_world

from ..ingest.test_grid_map import grid_of

MAZE = Path(__file__).parents[2] / "sample_logs" / "maze-1.mcap"


@pytest.fixture
def place(samples, tmp_path):
    """A workspace with office-1, which has a laser, and streets-1, which has none."""
    return Workspace(shutil.copytree(samples / "topobatch-workspace", tmp_path / "ws"))


def w(place):
    return "-w", place.root


def test_scans_show_the_walls(topobatch, place) -> None:
    shown = topobatch("export", "office-1", "-f", "grid", *w(place))
    assert (shown.code, shown.err) == (0, "")
    picture, yaml = (place.exports / f"office-1{ending}" for ending in (".pgm", ".yaml"))
    assert shown.out.split() == [str(picture), str(yaml)]
    assert "# scans of office-1\n" in yaml.read_text()
    grid, notes = read_saved_map(yaml)
    assert (notes, grid.resolution_m) == ((), 0.05)
    assert driven_free(grid, place.read_map("office-1")) > 0.99
    assert 'image: "office-1.pgm"' in yaml.read_text()


def driven_free(grid, m) -> float:
    """Share of the corridors' points in free cells: robots drove through free space."""
    x, y = np.floor((np.concatenate(m.paths) - grid.origin[:2]) / grid.resolution_m).astype(int).T
    return float(grid.free[y, x].mean())


def test_where_the_log_is_gone_views_show_the_walls(topobatch, place, tmp_path) -> None:
    record = place.ingest_record("office-1")
    gone = json.loads(record.read_text()) | {"log": str(tmp_path / "gone.mcap")}
    record.write_text(json.dumps(gone))
    out = tmp_path / "office.yaml"
    call = ("export", "office-1", "-f", "grid", "-o", out, *w(place))
    shown = topobatch(*call)
    assert shown.code == 0
    assert "not there" in shown.err
    assert "those of its views, in cells of 0.2 m" in shown.err
    assert "# views of office-1\n" in out.read_text()
    assert 'image: "office.pgm"' in out.read_text()
    assert out.with_name("office.pgm").is_file()
    assert driven_free(read_saved_map(out)[0], place.read_map("office-1")) > 0.95
    assert "is not the log" in topobatch(*call, "--log", MAZE).error(1)


def test_detections_show_no_walls(topobatch, place) -> None:
    told = topobatch("export", "streets-1", "-f", "grid", *w(place)).error(1)
    assert "only junction detections" in told
    assert "--junctions-from scan" in told
    assert not (place.exports / "streets-1.yaml").exists()


def test_sites_without_walls_cost_no_other_its_grid(topobatch, place) -> None:
    shown = topobatch("export", "-f", "grid", *w(place))
    assert shown.code == 0
    assert [Path(line).name for line in shown.out.split()] == ["office-1.pgm", "office-1.yaml"]
    assert shown.err.count("left out") == 2


def test_lost_views_are_told(topobatch, place) -> None:
    place.map_views("office-1").unlink()
    told = topobatch("export", "office-1", "-f", "grid", *w(place)).error(1)
    assert "office-1.views is lost or damaged; ingest the log again" in told


def saved(folder, name, grid) -> Path:
    shades = np.where(grid.unknown, 205, np.where(grid.free, 254, 0)).astype(np.uint8)
    Image.fromarray(shades[::-1]).save(folder / f"{name}.png")
    x, y, yaw = grid.origin
    path = folder / f"{name}.yaml"
    path.write_text(
        f"image: {name}.png\nresolution: {grid.resolution_m}\norigin: [{x}, {y}, {yaw}]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


def test_saved_maps_come_out_as_they_were_and_those_of_a_site_as_one(topobatch, tmp_path) -> None:
    world = make_world("maze", 36, 151)
    order = np.argsort(world.xy[:, 0]).tolist()
    halves = set(order[: len(order) * 2 // 3]), set(order[len(order) // 3 :])
    left, right = (grid_of(world, seen, 0.1) for seen in halves)
    right = right._replace(free=right.free.T[::-1], unknown=right.unknown.T[::-1])  # by 90°
    place = Workspace(tmp_path / "ws")
    logs = [saved(tmp_path, "left", left), saved(tmp_path, "right", right)]
    assert topobatch("ingest", *logs, *w(place)).code == 0
    assert topobatch("export", "left", "-f", "grid", *w(place)).code == 0
    same, _ = read_saved_map(place.exports / "left.yaml")
    assert np.array_equal(same.free, left.free)
    assert np.array_equal(same.unknown, left.unknown)
    assert same.origin == pytest.approx(left.origin)

    assert topobatch("merge", "--all", "-q", *w(place)).code == 0
    result = place.read_result()
    assert len(result.components) == 1
    (site,) = set(result.sites.values())
    shown = topobatch("export", "-f", "grid", *w(place))
    assert (shown.code, shown.err) == (0, "")
    both, _ = read_saved_map(place.exports / f"{site}.yaml")
    whole = grid_of(world, None, 0.1)
    assert both.free.sum() * 0.05**2 == pytest.approx(whole.free.sum() * 0.1**2, rel=0.05)
