"""What contradicts a match."""

from dataclasses import replace

import pytest

from topobatch.merge.robust.prepare import prepare

from .plans import EDGES, POINTS, against, laid


@pytest.mark.parametrize("stubs", [[], [(8, -1.57)]], ids=["bend", "fork"])
def test_bends_contradict_only_maps_whose_detector_shows_them(drawn, stubs):
    more = [*POINTS, (8.5, -6)]
    split = [e for e in EDGES if e != (3, 4)] + [(3, 8), (8, 4)]
    a, b = drawn("a", POINTS, EDGES), drawn("b", more, split, stubs=stubs)
    scans = prepare(replace(a, shows_bends=False))
    b = prepare(b)
    for one, two in ((prepare(a), b), (b, prepare(a))):
        assert len(against(laid(one, two))) == 1
    for one, two in ((scans, b), (b, scans)):
        assert len(against(laid(one, two))) == len(stubs)


def test_a_junction_in_the_others_corridor_contradicts(drawn):
    more = [*POINTS, (8.5, -6)]
    split = [e for e in EDGES if e != (3, 4)] + [(3, 8), (8, 4)]
    a, b = prepare(drawn("a", POINTS, EDGES)), prepare(drawn("b", more, split, stubs=[(8, -1.57)]))
    for one, two, extra in ((a, b, "extra_b"), (b, a, "extra_a")):
        found = against(laid(one, two))
        assert len(found) == 1
        assert getattr(found, extra).tolist() == [8]
        row = getattr(found, extra + "_in")[0]
        assert {int(a.tail[row]), int(a.head[row])} == {3, 4}
        assert found.bits > 3


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
    passed = [{int(c.tail[r]), int(c.head[r])} for r in told.extra_a_in]
    assert ends + passed == [{6, 7}]
    assert told.bits > 1
    assert len(against(laid(a, a)).elsewhere) == 0
