"""`topobatch export --format grid`: what it makes of scans, views and saved maps."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from topobatch.cli.workspace import Workspace
from topobatch.ingest.logs.saved_map import read_saved_map
from topobatch.simulation import make_world
from topobatch.topology.document import read_map

from ..ingest.test_grid_map import grid_of

OFFICE = Path(__file__).parents[2] / "sample_logs" / "office-1.mcap"


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    """A workspace with a run that has a laser, and one without, and the log of the former."""
    from topobatch.cli.ingest_worker import IngestJob, ingest_one
    from topobatch.ingest.mapping_settings import MappingSettings
    from topobatch.ingest.reading import ReadSettings

    folder = tmp_path_factory.mktemp("grid")
    place = Workspace(folder / "ws")
    log = folder / OFFICE.name
    shutil.copy(OFFICE, log)
    for path in (log, OFFICE.with_name("streets-1.mcap")):
        job = IngestJob(path, path.stem, place, ReadSettings(), MappingSettings(), False)
        assert ingest_one(job, lambda more: None).status == "done"
    return place, log


def found_again(m, grid_map) -> float:
    """Share of the junctions of a map within 0.6 m of those of a map of its grid."""
    junctions = m.xy[m.degree >= 3]
    away, _ = cKDTree(grid_map.xy).query(junctions)
    return float((away <= 0.6).mean())


def ingested(topobatch, path, folder):
    done = topobatch("ingest", path, "-w", folder)
    assert done.code == 0, done
    return read_map(folder / "maps" / f"{path.stem}.json")


def test_scans_show_the_walls_with_the_same_junctions(topobatch, office, tmp_path) -> None:
    place, _ = office
    shown = topobatch("export", "office-1", "-f", "grid", "-w", place.root)
    assert (shown.code, shown.err) == (0, "")
    picture, yaml = (place.exports / f"office-1{ending}" for ending in (".pgm", ".yaml"))
    assert shown.out.split() == [str(picture), str(yaml)]
    assert "# scans of office-1\n" in yaml.read_text()
    grid, notes = read_saved_map(yaml)
    assert (notes, grid.resolution_m) == ((), 0.05)
    m = place.read_map("office-1")
    assert found_again(m, ingested(topobatch, yaml, tmp_path)) >= 0.9
    # Robots drove through free space.
    points = np.concatenate(m.paths)
    x, y = np.floor((points - grid.origin[:2]) / 0.05).astype(int).T
    assert grid.free[y, x].mean() > 0.99
    again = topobatch("export", "office-1", "-f", "grid", "-o", tmp_path / "a.yaml", *w(place))
    assert again.code == 0
    assert (tmp_path / "a.pgm").read_bytes() == picture.read_bytes()
    assert 'image: "a.pgm"' in (tmp_path / "a.yaml").read_text()


def w(place):
    return "-w", place.root


def test_where_the_log_is_gone_views_show_the_walls(topobatch, office, tmp_path) -> None:
    place, log = office
    moved = log.rename(tmp_path / "elsewhere.mcap")
    out = tmp_path / "office.yaml"
    try:
        shown = topobatch("export", "office-1", "-f", "grid", "-o", out, *w(place))
        assert shown.code == 0
        assert "not there any more" in shown.err
        assert "those of its views, in cells of 0.2 m" in shown.err
        assert "# views of office-1\n" in out.read_text()
        m = place.read_map("office-1")
        assert found_again(m, ingested(topobatch, out, tmp_path / "ws")) >= 0.8
        call = ("export", "office-1", "-f", "grid", "-o", tmp_path / "there.yaml", *w(place))
        assert topobatch(*call, "--log", moved).err == ""
        assert "scans of" in (tmp_path / "there.yaml").read_text()
        other = OFFICE.with_name("maze-1.mcap")
        assert "holds no scans" in topobatch(*call, "--log", other).error(1)
    finally:
        moved.rename(log)


def test_detections_show_no_walls(topobatch, office) -> None:
    place, _ = office
    told = topobatch("export", "streets-1", "-f", "grid", *w(place)).error(1)
    assert "only junction detections" in told
    assert "--junctions-from scan" in told
    assert not (place.exports / "streets-1.yaml").exists()


def test_lost_views_are_told(topobatch, office, tmp_path) -> None:
    place, _ = office
    views = place.map_views("office-1")
    aside = views.rename(tmp_path / "aside")
    try:
        told = topobatch("export", "office-1", "-f", "grid", *w(place)).error(1)
        assert "office-1.views is lost or damaged; ingest the log again" in told
    finally:
        aside.rename(views)


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
    world = make_world("maze", 60, 151)
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
    document = place.read_merged()
    assert len(document.graph.components) == 1
    (site,) = set(document.graph.sites.values())
    shown = topobatch("export", "-f", "grid", *w(place))
    assert (shown.code, shown.err) == (0, "")
    both, _ = read_saved_map(place.exports / f"{site}.yaml")
    whole = grid_of(world, None, 0.1)
    assert both.free.sum() * 0.05**2 == pytest.approx(whole.free.sum() * 0.1**2, rel=0.05)
    m = ingested(topobatch, place.exports / f"{site}.yaml", tmp_path / "again")
    junctions = np.array([(n.x, n.y) for n in document.nodes if len(n.branches) >= 3])
    away, _ = cKDTree(m.xy).query(junctions)
    assert (away <= 0.6).mean() >= 0.95
