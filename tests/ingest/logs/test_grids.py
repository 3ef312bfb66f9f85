"""Grids out of messages."""

from __future__ import annotations

from types import ModuleType

from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.ingest.logs.grids import grid_of_message
from topobatch.ingest.logs.messages import Channel, DamageError


@settings(max_examples=150)
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
