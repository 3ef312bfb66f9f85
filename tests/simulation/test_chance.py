"""Random numbers that are the same on any machine."""

from __future__ import annotations

import pytest

from topobatch.simulation.chance import Chance


def test_chance_gives_these_very_numbers_everywhere() -> None:
    chance = Chance("stream", 7)
    assert chance.uniform(0.0, 1.0, 2).tolist() == [0.7755066270170754, 0.9767604405301428]
    assert Chance("stream", 7).normal(1.0, 2).tolist() == pytest.approx(
        [0.7571053551509976, 1.991016084793955], abs=1e-9
    )
