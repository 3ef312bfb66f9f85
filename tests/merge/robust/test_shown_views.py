"""The views that are shown of a placement."""

from dataclasses import replace

import numpy as np

from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.shown_views import most_telling
from topobatch.topology.matching.views import AGREES, CONTRADICTS
from topobatch.topology.se2 import inverse

from .plans import SETTINGS
from .rooms import views_of, walls_of


def test_those_that_speak_most_for_a_placement_and_most_against_it(halves) -> None:
    left, right = halves
    a, b = prepare(left), prepare(right)
    (before, *_) = match(a, b, SETTINGS)
    assert most_telling(a, b, before) == {}
    walls, others = (walls_of(k, size_m=80.0) - np.tile([20.0, 20.0], 2) for k in (1, 2))
    places = left.xy[before.a]
    there = tuple(inverse(before.transform).tolist())
    true, false = views_of(walls, places, there), views_of(others, places, there)
    half = np.arange(len(places)) < len(places) // 2
    # Half of what b saw is of another building.
    mixed = np.where(half[:, None, None], true.cells, false.cells)
    a = prepare(replace(left, views=views_of(walls, places)))
    b = prepare(replace(right, views=replace(true, cells=mixed)))
    found = max(match(a, b, SETTINGS), key=lambda c: len(set(c.a) & set(before.a)))
    shown = most_telling(a, b, found)
    assert shown.keys() == {int(found.views.bits.argmax()), int(found.views.bits.argmin())}
    for part, views in shown.items():
        kinds = np.bincount(views.laid.kind, minlength=3)
        more = AGREES if found.views.bits[part] > 0 else CONTRADICTS
        assert kinds[more] > kinds[AGREES + CONTRADICTS - more]
        assert dict(zip(before.a.tolist(), before.b.tolist(), strict=True))[views.near_a] == (
            views.near_b
        )
