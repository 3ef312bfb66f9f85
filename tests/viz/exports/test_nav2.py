"""Nav2's GeoJSON, read by the rules of its loader."""

from __future__ import annotations

from dataclasses import replace

import pytest

from topobatch.topology.errors import DataError

from .readers import read_nav2, text_of


def test_nav2_times_are_the_medians_of_what_was_driven(odd_map) -> None:
    graph = read_nav2(text_of(odd_map, "nav2"))
    taken: dict[int, list[float]] = {}
    for *_, data in graph.edges(data=True):
        taken.setdefault(data["corridor"], []).append(data.get("abs_time_taken"))
    assert taken[0] == [5.0, 5.0]  # 4 s there, 6 s back
    assert sum(taken[1]) == pytest.approx(2 * 4.0, abs=0.03)
    assert set(taken[2]) == {None}


def test_nav2_says_how_far_drives_differ(odd_map) -> None:
    graph = read_nav2(text_of(odd_map, "nav2"))
    said: dict[int, list[float]] = {}
    for *_, data in graph.edges(data=True):
        said.setdefault(data["corridor"], []).append(data.get("time_sigma"))
    # 4 s and 6 s are 5 s, give or take 28 %; the mean of the two is known to 1 s.
    assert said[0] == [1.0, 1.0]
    once = sum(sigma**2 for sigma in said[1]) / 2
    assert once == pytest.approx((4.0 * 0.2 * 2**0.5) ** 2, rel=0.05)
    assert set(said[2]) == {None}


def test_without_times_there_is_none(driven) -> None:
    text = text_of(replace(driven[1], traversal_ns=None), "nav2")
    read_nav2(text)
    assert "abs_time_taken" not in text


def test_nav2_wants_a_corridor(bare_map) -> None:
    with pytest.raises(DataError, match="no corridor"):
        text_of(bare_map, "nav2")
