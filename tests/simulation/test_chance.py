"""Random numbers that are the same on any machine."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.simulation.chance import Chance, quantised


def test_chance_gives_these_very_numbers_everywhere() -> None:
    chance = Chance("stream", 7)
    assert chance.uniform(0.0, 1.0, 2).tolist() == [0.7755066270170754, 0.9767604405301428]
    assert Chance("stream", 7).normal(1.0, 2).tolist() == pytest.approx(
        [0.7571053551509976, 1.991016084793955], abs=1e-9
    )


def test_chance_has_the_distributions_it_names() -> None:
    chance = Chance(1)
    normal = chance.normal(2.0, 20_000)
    assert abs(normal.mean()) < 0.06
    assert normal.std() == pytest.approx(2.0, rel=0.03)
    assert np.bincount([chance.weighted_index(np.array([0, 3.0, 1])) for _ in range(400)])[0] == 0
    assert sorted(chance.order(9).tolist()) == list(range(9))


def test_quantised_sums_are_exact() -> None:
    values = quantised(Chance(2).uniform(-1.0, 1.0, 1000), 20)
    assert np.sum(values[::-1]) == np.sum(values) == sum(values.tolist())
