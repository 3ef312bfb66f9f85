"""Views beside the document of their map."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.topology.document import map_to_document, read_map, write_map
from topobatch.topology.topomap import TopoMap
from topobatch.topology.view_file import from_bytes, record_of, to_bytes, views_path
from topobatch.topology.views import SIDE, Views

from ..maps import straight_map


def some_views(count: int = 3, seed: int = 0) -> Views:
    """Views of two walls each, with a bit of noise."""
    rng = np.random.default_rng(seed)
    cells = np.zeros((count, SIDE, SIDE), np.uint8)
    cells[:, 20:60, 20:60] = 1
    cells[:, 20:60, 30] = cells[:, 30, 20:60] = 2
    cells[rng.random(cells.shape) < 0.01] = 2
    pose = np.round(rng.normal(0, 30, (count, 3)), 3)
    return Views(np.arange(count) * 10**9, pose, cells)


def two_junctions() -> TopoMap:
    """Two junctions and the corridor between them."""
    return straight_map("run1", [(0.0, 0.0), (8.0, 0.0)], [(0, 1)])


def with_some_views() -> TopoMap:
    return replace(two_junctions(), views=some_views())


def test_views_come_back_and_take_little_room() -> None:
    views = some_views(20)
    data = to_bytes(views)
    found = from_bytes(data, record_of(views))
    assert data == to_bytes(found)
    np.testing.assert_array_equal(found.cells, views.cells)
    np.testing.assert_array_equal(found.time_ns, views.time_ns)
    np.testing.assert_allclose(found.pose, views.pose, atol=1e-9)
    assert len(data) < 1000 * len(views)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[:-200],
        lambda data: data[:100] + bytes([data[100] ^ 1]) + data[101:],
        lambda data: b"something else",
        lambda data: b"",
        lambda data: to_bytes(some_views(3, seed=1)),
        lambda data: to_bytes(some_views(400)),
    ],
)
def test_what_is_not_the_views_of_the_record_is_refused(spoil) -> None:
    views = some_views()
    with pytest.raises(ValueError, match="is "):
        from_bytes(spoil(to_bytes(views)), record_of(views))


def test_lost_or_damaged_views_are_told_and_the_document_still_names_them(tmp_path: Path) -> None:
    topomap, path = with_some_views(), tmp_path / "run1.json"
    write_map(path, topomap)
    views_path(path).write_bytes(views_path(path).read_bytes()[:-200])
    found = read_map(path)
    assert found.views_lost
    assert map_to_document(found) == map_to_document(topomap)
    views_path(path).unlink()
    assert read_map(path).views_lost
