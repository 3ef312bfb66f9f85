"""What contradicts a match."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust.conflicts import NO_CONFLICTS, Unseen
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.settings import MATCH

from .plans import EDGES, POINTS, against, laid


def test_corridors_that_lead_elsewhere_contradict_once(drawn):
    a = prepare(drawn("a", POINTS, EDGES))
    # 7 stands farther on, where a run that drove to 7 in a would not have met it.
    moved = [*POINTS[:7], (9, 9)]
    b = prepare(drawn("b", moved, EDGES))
    matched = laid(a, b)
    kept = matched.a != 7
    parts = {name: getattr(matched, name)[kept] for name in ("lane", "a", "row", "branch")}
    found = against(replace(matched, **parts))
    assert len(found.elsewhere) <= 1
    straight = [*POINTS[:7], (11.5, 4)]
    c = prepare(drawn("c", straight, EDGES))
    grown = laid(a, c)
    assert 7 not in grown.a
    told = against(grown)
    ends = [{int(a.tail[r]), int(a.head[r])} for r in told.elsewhere[:, 0]]
    passed = [{int(c.tail[r]), int(c.head[r])} for r in told.in_b.edge]
    assert ends + passed == [{6, 7}]
    assert told.bits > 1
    assert len(against(laid(a, a)).elsewhere) == 0


def test_a_contradiction_weighs_as_one_junction_at_most():
    told = replace(
        NO_CONFLICTS,
        in_b=Unseen(np.arange(2), np.arange(2), np.array([0.2, 4.0]) * MATCH.junction_bits),
        elsewhere=np.zeros((2, 2), np.int64),
        elsewhere_bits=0.5 * MATCH.junction_bits,
    )
    assert told.junctions == pytest.approx(0.2 + 1.0 + 2 * 0.5)
