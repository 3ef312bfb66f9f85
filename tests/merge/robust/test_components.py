"""Runs that accepted pairs join."""

import numpy as np

from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.components import Components, as_alignment, join_all
from topobatch.merge.robust.prepare import prepare
from topobatch.topology.se2 import compose, inverse

from .plans import SETTINGS


def test_cycles_that_contradict_give_way_at_their_weakest_link(halves):
    a, b = (prepare(m) for m in halves)
    found = as_alignment(match(a, b, SETTINGS)[0])
    straight = {(0, 1): found, (1, 2): found, (0, 2): found}
    groups = Components(3, [])
    refused = join_all(groups, [(0, 1), (1, 2), (0, 2)], straight, [a.z, b.z, b.z], ["x", "y", "z"])
    assert set(refused) == {(0, 2)}
    assert "place the two differently" in refused[0, 2].reason
    assert groups.together(0, 2)


def test_poses_of_components_follow_when_they_join():
    groups = Components(4, [(0, 3)])
    T01, T23, T12 = np.array([1.0, 2.0, 0.3]), np.array([-4.0, 1.0, 1.2]), np.array([5.0, 0, -2.0])
    groups.join(0, 1, T01)
    assert groups.forbidden(1, 3) == (0, 3)
    assert groups.forbidden(1, 2) is None
    groups.join(2, 3, T23)
    groups.join(1, 2, T12)
    assert np.allclose(groups.relative(0, 3), compose(compose(T01, T12), T23))
    assert np.allclose(groups.relative(3, 0), inverse(groups.relative(0, 3)))
