import numpy as np
import pytest

from topobatch.ingest.logs.saved_map import read_saved_map
from topobatch.topology.run import Grid
from topobatch.viz.exports.map_server import map_picture, map_yaml


def test_a_grid_is_read_back_as_it_was(tmp_path) -> None:
    rng = np.random.default_rng(1)
    state = rng.integers(0, 3, (7, 11))
    grid = Grid(state == 0, state == 1, 0.05, (-1.25, 3.5, 0.25))
    (tmp_path / "a b.pgm").write_bytes(map_picture(grid))
    (tmp_path / "a.yaml").write_text(map_yaml(grid, "a b.pgm", ["made of\nruns: x"]))
    found, notes = read_saved_map(tmp_path / "a.yaml")
    assert notes == ()
    assert np.array_equal(found.free, grid.free)
    assert np.array_equal(found.unknown, grid.unknown)
    assert found.resolution_m == 0.05
    assert found.origin == pytest.approx(grid.origin)
    first, second = (tmp_path / "a.yaml").read_text().splitlines()[:2]
    assert first.startswith("# made of")
    assert second == 'image: "a b.pgm"'
