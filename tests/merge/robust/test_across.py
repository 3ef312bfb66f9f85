"""Copies of components, told by all pairs across them."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust.across import COPY_TOGETHER, LARGER_TOGETHER, Across
from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.components import Components, as_alignment
from topobatch.merge.robust.prepare import prepare

from .plans import EDGES, POINTS, SETTINGS


@pytest.fixture
def sizes(drawn):
    """Two maps of one plan, and two of it 2 % larger; each pair by its best alignment."""
    larger = [(1.02 * x, 1.02 * y) for x, y in POINTS]
    plans = {"a": POINTS, "b": POINTS, "c": larger, "d": larger}
    maps = [drawn(name, plan, EDGES) for name, plan in plans.items()]
    scale = 0.006
    prepared = [prepare(replace(m, noise=replace(m.noise, scale=scale))) for m in maps]
    found = {
        (i, j): match(prepared[i], prepared[j], SETTINGS)[0] for j in range(4) for i in range(j)
    }
    joins = {pair: as_alignment(c) for pair, c in found.items()}
    places = [m.z for m in prepared]
    return Across(prepared, places, joins, {}, {}, _nothing, (), SETTINGS.size_sigmas), found


def _nothing(pairs):
    return [0.0] * len(pairs)


def by_size(own):
    """Components of the two maps of each size."""
    components = Components(4, ())
    for i, j in ((0, 1), (2, 3)):
        components.join(i, j, own.joins[i, j].transform)
    return components


def test_more_runs_tell_more_than_two(sizes):
    """Their scales err apart: of two runs on either side by less than of one."""
    own, _ = sizes
    components = Components(4, ())
    across = {pair: own.joins[pair] for pair in ((0, 2), (0, 3), (1, 2), (1, 3))}
    alone = own._sigmas(components, (0, 2), {(0, 2): across[0, 2]})
    for i, j in ((0, 1), (2, 3)):
        components.join(i, j, own.joins[i, j].transform)
    together = own._sigmas(components, (0, 2), across)
    assert alone < own.most_sigmas < together < 2 * alone
    assert own._sigmas(components, (1, 3), across) == pytest.approx(together)
    known = replace(own, other={(0, 3): across[0, 3]})
    assert known.refusal(components, (0, 2)) is LARGER_TOGETHER
    assert own.refusal(components, (0, 2)) is None  # no pair says so by itself
    assert replace(known, locked=[(0, 2)]).refusal(components, (0, 2)) is None


def test_a_pair_that_lies_elsewhere_says_nothing(sizes):
    own, _ = sizes
    components = by_size(own)
    away = replace(own.joins[0, 3], transform=own.joins[0, 3].transform + np.array([9.0, 0.0, 0.0]))
    assert replace(own, other={(0, 3): away}).refusal(components, (0, 2)) is None


def test_what_pairs_across_say_of_copies_adds_up(sizes):
    own, _ = sizes
    components = by_size(own)
    for bits, refused in (((-9.0, 3.0), True), ((-6.0, 3.0), False), ((1.0, 3.0), False)):
        told = dict(zip(((0, 3), (1, 2)), bits, strict=True))
        asked = {pair: (own.joins[pair], said) for pair, said in told.items()}
        found = replace(own, asked=asked).refusal(components, (0, 2))
        assert found is (COPY_TOGETHER if refused else None)
        locked = replace(own, asked=asked, locked=[(0, 2)])
        assert locked.refusal(components, (0, 2)) is None


def test_pairs_that_would_be_merged_answer_whether_they_are_copies(sizes):
    """That chance does not explain them says nothing of it."""
    own, _ = sizes
    components = by_size(own)
    heard = []

    def answers(bits):
        return lambda pairs: heard.append(pairs) or [bits] * len(pairs)

    asked = {(0, 3): (own.joins[0, 3], -9.0)}
    for bits, refused in ((1.0, True), (2.0, False)):
        known = replace(own, asked=asked, answers=answers(bits))
        assert known.refusal(components, (0, 2)) is (COPY_TOGETHER if refused else None)
    assert heard == [[(0, 2), (1, 2), (1, 3)]] * 2
    assert replace(own, answers=answers(-9.0)).refusal(components, (0, 2)) is None
    assert len(heard) == 2  # nobody was asked where no pair looks like a copy by itself
