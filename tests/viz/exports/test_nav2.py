"""Nav2's GeoJSON, read by the rules of its loader."""

from __future__ import annotations

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


def test_nav2_wants_a_corridor(bare_map) -> None:
    with pytest.raises(DataError, match="no corridor"):
        text_of(bare_map, "nav2")
