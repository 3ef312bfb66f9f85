import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from topobatch.topology.se2 import apply, rotation
from topobatch.viz.sheet import arrange, upright_rad


def cross(turn: float) -> list[np.ndarray]:
    lines = [np.array([(-10.0, 0.0), (10.0, 0.0)]), np.array([(0.0, -4.0), (0.0, 4.0)])]
    return [line @ rotation(turn).T for line in lines]


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.7, 1.2, 2.0, -2.9])
def test_a_rectilinear_map_is_turned_onto_the_axes_and_lies_wide(turn: float) -> None:
    lines = cross(turn)
    straight = [line @ rotation(upright_rad(lines)).T for line in lines]
    for line in straight:
        assert np.min(np.abs(line[1] - line[0])) < 1e-9
    width, height = np.ptp(np.concatenate(straight), axis=0)
    assert width == pytest.approx(20)
    assert height == pytest.approx(8)


def test_a_map_without_a_common_direction_lies_along_its_extent() -> None:
    rng = np.random.default_rng(1)
    cloud = rng.normal(size=(300, 2)) * [12.0, 2.0] @ rotation(0.9).T
    turned = cloud @ rotation(upright_rad([cloud])).T
    assert np.ptp(turned[:, 0]) > 2 * np.ptp(turned[:, 1])


sizes = st.lists(st.tuples(st.floats(0, 80), st.floats(0, 80)), max_size=30)


@given(sizes, st.floats(-3, 3))
def test_cells_hold_their_maps_and_do_not_overlap(
    sizes: list[tuple[float, float]], turn: float
) -> None:
    points = [np.array([(5.0, 5.0), (5.0 + w, 5.0 + h)]) for w, h in sizes]
    cells = arrange(points, [turn] * len(points), margin_m=1.0)
    assert len(cells) == len(points)
    for cell, own in zip(cells, points, strict=True):
        on_sheet = apply(cell.T_sheet_map, own)
        assert np.all(on_sheet >= cell.low + 1.0 - 1e-6)
        assert np.all(on_sheet <= cell.high - 1.0 + 1e-6)
    for i, a in enumerate(cells):
        for b in cells[i + 1 :]:
            shared = np.minimum(a.high, b.high) - np.maximum(a.low, b.low)
            assert shared.min() <= 1e-6


@given(st.lists(st.tuples(st.floats(1, 80), st.booleans()), min_size=1, max_size=20))
def test_groups_stay_in_one_row(boxes: list[tuple[float, bool]]) -> None:
    points = [np.array([(0.0, 0.0), (w, 10.0)]) for w, _ in boxes]
    groups = np.cumsum([new for _, new in boxes]).tolist()
    cells = arrange(points, [0.0] * len(points), 1.0, groups=groups)
    for i in range(1, len(cells)):
        if groups[i] == groups[i - 1]:
            assert cells[i].high[1] == cells[i - 1].high[1]
