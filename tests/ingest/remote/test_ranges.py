"""Ranges: nothing that is wanted is missing, and little else is read."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from topobatch.ingest.remote.ranges import GAP_BYTES, WASTE, coalesced, in_parts, without

RANGES = st.lists(
    st.tuples(st.integers(0, 3_000_000), st.integers(0, 300_000)).map(lambda r: (r[0], sum(r))),
    max_size=30,
)


def arrays(ranges: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    pairs = np.array(ranges, np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def covered(ranges: list[tuple[int, int]]) -> np.ndarray:
    out = np.zeros(3_300_001, bool)
    for begin, end in ranges:
        out[begin:end] = True
    return out


@given(RANGES)
def test_coalesced_ranges_hold_all_that_is_wanted_and_little_more(
    ranges: list[tuple[int, int]],
) -> None:
    begin, end = coalesced(*arrays(ranges))
    found, wanted = covered(list(zip(begin, end, strict=True))), covered(ranges)
    assert not (wanted & ~found).any()
    assert found.sum() <= (1 + WASTE) * wanted.sum()
    assert (begin[1:] > end[:-1]).all()


def test_small_gaps_are_closed_first_and_long_ones_never() -> None:
    begin, end = coalesced(*arrays([(0, 1000), (1020, 2000), (2015, 3000), (4000, 5000)]))
    assert list(zip(begin, end, strict=True)) == [(0, 3000), (4000, 5000)]
    begin, _ = coalesced(*arrays([(0, 10**9), (10**9 + GAP_BYTES + 1, 2 * 10**9)]))
    assert len(begin) == 2


@given(RANGES, st.integers(1, 100_000))
def test_parts_are_the_ranges_cut_up(ranges: list[tuple[int, int]], most: int) -> None:
    begin, end = coalesced(*arrays(ranges))
    parts = in_parts(begin, end, most)
    assert all(0 < last - first <= most for first, last in parts)
    assert sum(last - first for first, last in parts) == int((end - begin).sum())
    assert (covered(parts) == covered(list(zip(begin, end, strict=True)))).all()


@given(RANGES, RANGES)
def test_what_is_held_is_left_out(
    ranges: list[tuple[int, int]], held: list[tuple[int, int]]
) -> None:
    begin, end = without(*arrays(ranges), held)
    left = covered(list(zip(begin, end, strict=True)))
    assert (left == (covered(ranges) & ~covered(held))).all()
    assert (np.diff(begin) >= 0).all()
