"""Candidates as bytes."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust import DEFAULT_ROBUST, match, prepare
from topobatch.merge.robust.prepare import Extent
from topobatch.merge.robust.records import from_bytes, in_short, to_bytes
from topobatch.merge.robust.view_evidence import ViewEvidence


@pytest.fixture(scope="module")
def pair(halves):
    return tuple(prepare(m) for m in halves)


def extents(pair):
    return [m.extent for m in pair]


def flat(value):
    """All numbers of a value of arrays and values."""
    if hasattr(value, "__dataclass_fields__"):
        return [x for name in value.__dataclass_fields__ for x in flat(getattr(value, name))]
    return [np.asarray(value)]


def test_candidates_are_the_same_to_the_last_bit(pair):
    found = match(*pair, DEFAULT_ROBUST)
    assert found
    found = (*found, replace(found[0], rival=True))
    again = from_bytes(to_bytes(found), *extents(pair))
    assert len(again) == len(found)
    for before, after in zip(found, again, strict=True):
        for x, y in zip(flat(before), flat(after), strict=True):
            assert x.dtype == y.dtype
            np.testing.assert_array_equal(x, y)


def test_only_what_chance_does_not_offer_is_kept_in_full(pair, other_maze, see):
    found = match(*pair, DEFAULT_ROBUST)
    assert in_short(found, DEFAULT_ROBUST).candidates == found
    stranger = prepare(see(other_maze, list(range(30)), 9, "stranger"))
    short = in_short(match(pair[0], stranger, DEFAULT_ROBUST), DEFAULT_ROBUST)
    assert short.candidates == ()
    assert in_short((), DEFAULT_ROBUST).faint is None


def test_bytes_of_other_maps_are_refused(pair, other_maze, see):
    small = prepare(see(other_maze, list(range(6)), 9, "small"))
    data = to_bytes(match(*pair, DEFAULT_ROBUST))
    assert from_bytes(data, small.extent, pair[1].extent) is None
    assert from_bytes(data, pair[0].extent, small.extent) is None


def test_no_bytes_reach_outside(pair):
    """Cut off or overwritten, they are refused or make a candidate within the two maps."""
    data = to_bytes(match(*pair, DEFAULT_ROBUST))
    for end in range(1, len(data), 7):
        cut = from_bytes(data[:end], *extents(pair))
        assert cut is None or len(to_bytes(cut)) == end
    a, b = pair
    read = 0
    for at in range(0, len(data) - 8, 4):
        for junk in (b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\0"):
            broken = data[:at] + junk + data[at + 4 :]
            for c in from_bytes(broken, *extents(pair)) or ():
                assert a.z[c.a].shape == b.z[c.b].shape
                assert a.length[c.corridors[:, 0]].shape == b.length[c.corridors[:, 1]].shape
                assert np.isfinite(c.transform).all()
                read += 1
    assert read > 0


def test_a_map_need_not_be_prepared_to_know_how_large_it_is(halves):
    for m in halves:
        assert Extent.of(m) == prepare(m).extent


def test_what_views_say_comes_back(pair):
    found = match(*pair, DEFAULT_ROBUST)[:1]
    said = ViewEvidence(
        np.array([0, 1, 1]),
        np.array([2, 0, 1]),
        np.array([4.0, 3.5, -1.0]),
        np.array([0, 0, 1]),
        np.array([8.5, -4.0]),
        3.5,
        0.25,
        np.array([0.5, 0.4]),
    )
    found = (replace(found[0], views=said, by_views=True),)
    seen = [extent._replace(views=3) for extent in extents(pair)]
    (again,) = from_bytes(to_bytes(found), *seen)
    for x, y in zip(flat(found[0]), flat(again), strict=True):
        np.testing.assert_array_equal(x, y)
    assert from_bytes(to_bytes(found), *extents(pair)) is None
