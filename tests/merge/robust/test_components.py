"""Runs that accepted pairs join."""

from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.components import Components, as_alignment, join_all
from topobatch.merge.robust.prepare import prepare

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
