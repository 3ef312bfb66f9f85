"""Lines thinned, sharpened at corners, and led to the centres of junctions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from topobatch.topology.polyline import join_centres, loop_erased, loop_width, simplify, way_of


def test_simplified_lines_stay_near():
    rng = np.random.default_rng(1)
    path = np.cumsum(rng.normal(size=(200, 2)), axis=0)
    thin = simplify(path, 0.5)
    assert 2 <= len(thin) < 200
    assert thin[0].tolist() == path[0].tolist()
    assert thin[-1].tolist() == path[-1].tolist()
    a, b = thin[:-1, None], thin[1:, None]
    t = np.clip(((path - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0, 1)
    off = np.linalg.norm(path - a - t[..., None] * (b - a), axis=-1).min(axis=0)
    assert off.max() <= 0.5 + 1e-9
    closed = simplify(np.array([[0, 0], [1, 0], [1, 1], [0, 0.0]]), 0.1)
    assert len(closed) == 4


@pytest.mark.parametrize("aside", [0.8, -1.2])
@pytest.mark.parametrize("length", [1.5, 6.0])
def test_who_passes_aside_of_a_centre_goes_as_far_as_who_passes_through_it(aside, length):
    along = np.linspace(0.0, length, 61)
    track = np.column_stack([along, 0.05 * np.sin(along)])
    past = join_centres(track, np.array([0.0, aside]), np.array([length, aside]), 0.7)
    assert way_of(past)[-1] == pytest.approx(length, abs=0.03)
    assert np.abs(past[:, 1] - aside).max() < 0.06
    # Aside of one of the two: the way slants from it to the other.
    past = join_centres(track, np.array([0.0, aside]), np.array([length, 0.0]), 0.7)
    straight = float(np.hypot(length, aside))
    assert straight - 0.01 < way_of(past)[-1] < straight + 0.2 * (length < 2) + 0.03


coordinates = st.floats(-1e9, 1e9, allow_subnormal=False)
points = st.tuples(coordinates, coordinates)


@given(
    st.lists(points, max_size=12).map(lambda p: np.array(p).reshape(-1, 2)),
    points.map(np.array),
    points.map(np.array),
    st.sampled_from([0.0, 0.7, 1e9]),
)
def test_whatever_the_track_it_is_joined_to_the_centres(track, begin, end, reach):
    path = join_centres(track, begin, end, reach)
    assert np.isfinite(path).all()
    assert (path[0] == begin).all()
    assert (path[-1] == end).all()
    both = np.concatenate([begin[None], track, end[None]])
    assert np.abs(path).max() <= 3 * np.abs(both).max()
    assert way_of(path)[-1] >= np.hypot(*(end - begin)) * (1 - 1e-9)


def walked(*corners: tuple[float, float], step_m: float = 0.1) -> np.ndarray:
    """A track through points, sampled."""
    line = np.array(corners)
    way = way_of(line)
    at = np.arange(0, way[-1], step_m)
    return np.column_stack([np.interp(at, way, line[:, k]) for k in (0, 1)])


def test_what_was_driven_out_and_back_is_no_part_of_a_path() -> None:
    straight = walked((0, 0), (10, 0))
    detour = walked((0, 0), (5, 0), (5, 3), (5.2, 3), (5.2, 0), (10, 0))
    erased = loop_erased(detour, 0.5)
    assert way_of(detour)[-1] == pytest.approx(16.0, abs=0.2)
    assert way_of(erased)[-1] == pytest.approx(way_of(straight)[-1], abs=0.3)
    assert np.abs(erased[:, 1]).max() < 0.5
    assert (erased[[0, -1]] == detour[[0, -1]]).all()


def test_a_loop_is_as_wide_as_what_it_goes_round() -> None:
    ring = walked((0, 0), (10, 0), (10, 4), (0, 4), (0, 0))
    there_and_back = walked((0, 0), (6, 0), (6, 0.2), (0, 0.2), (0, 0))
    assert loop_width(ring) == pytest.approx(2 * 40 / 28, abs=0.1)
    assert loop_width(there_and_back) < 0.25
