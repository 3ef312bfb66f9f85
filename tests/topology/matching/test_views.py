"""Registration of views, and what their agreement tells."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.matching.likelihood import BIT
from topobatch.topology.matching.views import (
    AGREES,
    CONTRADICTS,
    SILENT,
    TURN_RAD,
    ViewIndex,
    ViewNull,
    _cells,
    compare,
    register,
)
from topobatch.topology.se2 import apply, between, wrap
from topobatch.topology.views import REACH_M

from ..floors import floor, views_at

TURNS = np.arange(-3, 4) * TURN_RAD


def registered(wall, one, other, turns=TURNS, **given):
    a, b = (ViewIndex.of(views_at(wall, [pose])) for pose in (one, other))
    zero = np.zeros(1, int)
    return register(a, b, zero, zero, turns[None], **given)


@pytest.mark.parametrize("other", [(30.7, 29.2, 0.1), (29.4, 30.9, -0.2), (30.0, 30.0, 0.02)])
def test_views_of_one_place_are_laid_over_each_other(other):
    one = (30.0, 30.0, 0.0)
    found = registered(floor(1), one, other)
    expected = between(np.array(one), np.array(other))
    assert np.hypot(*(found.transform[0, :2] - expected[:2])) < 0.15
    assert abs(wrap(found.transform[0, 2] - expected[2])) < 0.03
    assert found.z[0] > 3.5


def test_any_turn_is_found_among_those_that_are_tried():
    one, other = (30.0, 30.0, 0.3), (30.4, 30.2, 0.3 + 2.2)
    every = np.arange(-36, 36) * TURN_RAD
    found = registered(floor(2), one, other, every)
    expected = between(np.array(one), np.array(other))
    assert np.hypot(*(found.transform[0, :2] - expected[:2])) < 0.15
    assert abs(wrap(found.transform[0, 2] - expected[2])) < 0.03


def test_other_places_contradict():
    wall = floor(4)
    poses = np.array([[x, y, 0.0] for x in (15, 30, 45) for y in (15, 30, 45)])
    index = ViewIndex.of(views_at(wall, poses))
    first, second = np.triu_indices(len(poses), 1)
    other = register(index, index, first, second, np.tile(TURNS, (len(first), 1)))
    moved = ViewIndex.of(views_at(wall, poses + np.array([0.3, -0.2, 0.05])))
    every = np.arange(len(poses))
    same = register(index, moved, every, every, np.tile(TURNS, (len(every), 1)))
    assert same.z.min() > other.z.max() + 1.0


def test_a_bare_corridor_does_not_tell_how_far_along_it_one_is():
    wall = np.zeros((600, 600), bool)
    wall[[288, 289, 311, 312], :] = True
    found = registered(wall, (30, 30, 0), (30, 30, 0))
    along, across = found.information[0, 0, 0], found.information[0, 1, 1]
    assert across > 20 * along
    crossing = registered(floor(6), (30, 30, 0), (30, 30, 0))
    assert crossing.information[0, 0, 0] > 5 * along


def test_odds_are_measured_against_other_places_of_the_same_run():
    rng = np.random.default_rng(0)
    plain = ViewNull.of(rng.normal(0.5, 0.4, 300), np.full(9, 4.4))
    copies = ViewNull.of(rng.normal(2.8, 0.5, 300), np.full(9, 4.4))
    z = np.array([0.5, 2.5, 4.4, 9.0])
    assert plain.odds(z)[0] < 0 < plain.odds(z)[1]
    assert copies.odds(z)[1] < 0
    assert copies.odds(z)[2] < plain.odds(z)[2]
    assert (np.diff(copies.odds(np.linspace(-3, 6, 50))) >= 0).all()
    # Better than usual counts as usual, and nothing counts without bound.
    assert plain.odds(z)[2] == plain.odds(z)[3] <= 9 * BIT
    assert plain.odds(np.array([-5.0]))[0] >= -5 * BIT


def test_walls_of_two_views_are_told_apart():
    wall = floor(1)
    shut = wall.copy()
    shut[280:284, 290:330] = True  # a wall that only the second view saw
    one, other = np.array([30.0, 30.0, 0.3]), np.array([30.5, 29.6, -0.4])
    a, b = ViewIndex.of(views_at(wall, [one])), ViewIndex.of(views_at(shut, [other]))
    seen = compare(a, b, (0, 0), between(one, other))
    there = apply(one, seen.xy)
    known = views_at(wall, [one]).cells[0] == 2
    assert (~seen.of_second).sum() == known.sum()
    assert set(seen.kind[~seen.of_second]) <= {SILENT, AGREES}
    new = np.abs(there - (31.0, 28.2)) < (2.2, 0.5)
    against = (seen.kind == CONTRADICTS) & seen.of_second
    assert against.sum() > 10
    assert new.all(axis=1)[against].all()


def test_points_at_the_very_rim_are_outside():
    """Between the rim and the number before it, a sum of numbers of 32 bits rounds to the rim."""
    rim = np.nextafter(np.float32(REACH_M), np.float32(0))
    _, inside = _cells(np.array([rim, 1j * rim, rim - 0.01j], np.complex64))
    assert not inside.any()
