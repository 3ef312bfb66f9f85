"""Runs that accepted pairs join."""

from dataclasses import replace

import numpy as np

from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.components import Components, as_alignment, join_all
from topobatch.merge.robust.prepare import prepare
from topobatch.topology.se2 import compose

from .plans import SETTINGS


def test_cycles_that_contradict_give_way_at_their_weakest_link(halves):
    a, b = (prepare(m) for m in halves)
    found = as_alignment(match(a, b, SETTINGS)[0])
    straight = {(0, 1): found, (1, 2): found, (0, 2): found}
    groups = Components(3, [])
    refused = join_all(groups, [(0, 1), (1, 2), (0, 2)], straight, [a, b, b])
    assert set(refused) == {(0, 2)}
    assert "place the two differently" in refused[0, 2].reason
    assert groups.together(0, 2)


def test_a_cycle_closes_by_a_pair_that_views_alone_match(halves):
    a, b = (prepare(m) for m in halves)
    found = as_alignment(match(a, b, SETTINGS)[0])
    T = found.transform
    for off_m, refused in ((1.0, set()), (30.0, {(0, 2)})):
        around = compose(T, T) + np.array([off_m, 0.0, 0.0])
        by_views = replace(found, transform=around, matched=np.zeros((0, 2), np.int64))
        best = {(0, 1): found, (1, 2): found, (0, 2): by_views}
        groups = Components(3, [])
        assert set(join_all(groups, [(0, 1), (1, 2), (0, 2)], best, [a, b, b])) == refused
