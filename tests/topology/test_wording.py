"""Names, numbers and times in messages."""

from __future__ import annotations

from topobatch.topology.wording import quoted_formula, utc


def test_times_are_told_by_the_calendar_or_beyond_it() -> None:
    assert utc(0) == "1970-01-01 00:00:00"
    assert utc(2**62, "%Y-%m-%d %H:%M") == "2116-02-20 23:53"
    assert utc(10**29) == f"second {10**20}"


def test_formulas_are_quoted_and_numbers_are_not() -> None:
    for cell in ("=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", "\t=1", "-dock"):
        assert quoted_formula(cell) == f"'{cell}"
    for cell in ("", "dock", "-1.5", "+3", "-1e-3", "a=b", "{}", ".5"):
        assert quoted_formula(cell) == cell
