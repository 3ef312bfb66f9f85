"""Lengths of corridors of which several drives tell."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.corridor_lengths import corridor_lengths


def by_length(way, groups):
    return [np.array(sorted(group, key=lambda k: way[k])) for group in groups]


def test_of_a_straight_corridor_the_shortest_way_counts():
    way = np.array([8.02, 8.01, 8.3, 8.05])  # one went round somebody
    length, leg = corridor_lengths(way, np.full(4, 8.0), by_length(way, [range(4)]))
    assert (length.tolist(), leg.tolist()) == ([8.01], [1])


@pytest.mark.parametrize("drives", [2, 4])
def test_many_drives_along_bends_are_not_too_short(drives):
    """Errors to either side, with a variance in proportion to the bend, average out."""
    rng = np.random.default_rng(7)
    corridors = 400
    bend = rng.uniform(0.5, 4.0, corridors).repeat(drives)
    line = np.full(len(bend), 12.0)
    way = line + bend + 0.06 * np.sqrt(bend) * rng.standard_normal(len(bend))
    groups = by_length(way, np.arange(len(bend)).reshape(-1, drives))
    length, leg = corridor_lengths(way, line, groups)
    true = (line + bend)[::drives]
    shortest = way.reshape(-1, drives).min(axis=1)
    assert abs(np.mean(length - true)) < 0.015
    assert np.mean(shortest - true) < -0.04
    assert np.std(length - true) < 1.1 * np.mean(0.06 * np.sqrt(bend)) / np.sqrt(drives)
    assert (leg // drives).tolist() == list(range(corridors))
    assert np.abs(way[leg] - length).max() < 0.3
