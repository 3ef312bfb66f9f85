from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.driven_branches import driven_branches
from topobatch.topology.topomap import TopoMap
from topobatch.viz.drawing import (
    bounds,
    branch_arrows,
    extent,
    pen_m,
    ribbons,
    thinned,
)


@pytest.mark.parametrize("turn", [0.0, 1.0, 3.0])
def test_only_the_branch_that_nobody_drove_is_free(
    make_map: Callable[..., TopoMap], turn: float
) -> None:
    topomap = make_map("r", (1.0, 2.0, turn))
    free = np.flatnonzero(~driven_branches(topomap))
    assert len(free) == 1
    assert topomap.branches.owner[free[0]] == 0
    down = topomap.branches.values[free[0]] - turn
    assert np.cos(down + np.pi / 2) == pytest.approx(1)


def test_branches_that_corridors_name_are_driven(make_map: Callable[..., TopoMap]) -> None:
    topomap = make_map("r")
    parts = {name: getattr(topomap, name) for name in TopoMap.__dataclass_fields__}
    # The first corridor says that it leaves vertex 0 downwards, whatever its path looks like.
    named = TopoMap(**parts | {"source_branch": np.array([0, -1, -1, -1, -1])})
    assert driven_branches(named)[0]


def test_a_map_reaches_as_far_as_its_corridors(make_map: Callable[..., TopoMap]) -> None:
    topomap = make_map("r")
    beside = np.array([topomap.xy[2], (20.0, 12.0), topomap.xy[4]])
    bulging = replace(topomap, paths=(*topomap.paths[:4], beside))
    assert extent(bulging).max(axis=0).tolist() == [20.0, 12.0]


def test_arrows_point_along_their_branches(make_map: Callable[..., TopoMap]) -> None:
    topomap = make_map("r")
    origins, vectors = branch_arrows(topomap, 2.0)
    assert origins.shape == vectors.shape == (11, 2)
    assert vectors[0] == pytest.approx([0.0, -2.0])
    assert origins[-1] == pytest.approx(topomap.xy[4])


def test_a_ribbon_keeps_its_distance_round_a_corner() -> None:
    path = np.array([(0.0, 0.0), (5.0, 0.0), (5.0, 0.0), (5.0, 5.0)])
    left, right = ribbons([path, path], np.array([0.5, -0.5]))
    assert left == pytest.approx(np.array([(0.0, 0.5), (4.5, 0.5), (4.5, 5.0)]))
    assert right == pytest.approx(np.array([(0.0, -0.5), (5.5, -0.5), (5.5, 5.0)]))


def test_a_ribbon_throws_no_spikes_where_the_path_turns_back() -> None:
    path = np.array([(0.0, 0.0), (5.0, 0.0), (0.0, 0.01)])
    (beside,) = ribbons([path], np.array([0.5]))
    assert np.abs(beside - path).max() <= 1.0 + 1e-9


def test_a_ribbon_of_a_path_without_extent_or_offset_is_the_path() -> None:
    point, line = np.ones((2, 2)), np.array([(0.0, 0.0), (1.0, 0.0)])
    first, second, third = ribbons([point, line, line], np.array([0.5, 0.0, 2.0]))
    assert first is point
    assert second is line
    assert third == pytest.approx(np.array([(0.0, 2.0), (1.0, 2.0)]))
    assert ribbons([], np.zeros(0)) == []


def test_thinning_keeps_the_ends_and_the_spacing() -> None:
    xy = np.stack([np.linspace(0, 10, 1001), np.zeros(1001)], axis=-1)
    rows = thinned(xy, 0.5)
    assert rows[0] == 0
    assert rows[-1] == 1000
    assert 20 <= len(rows) <= 22
    assert thinned(np.zeros((500, 2)), 0.5).tolist() == [0, 499]


def test_pens_follow_the_usual_corridor(make_map: Callable[..., TopoMap]) -> None:
    topomap = make_map("r")
    assert pen_m([topomap, topomap]) == pytest.approx(0.035 * 6.0)
    assert pen_m([]) > 0


def test_bounds_of_nothing_have_an_extent() -> None:
    low, high = bounds([], margin=0.1)
    assert np.all(high > low)
