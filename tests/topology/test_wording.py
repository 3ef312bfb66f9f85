"""Names, numbers and times in messages."""

from __future__ import annotations

from topobatch.topology.wording import counted, listed, quoted_formula, to_turning_points, utc


def test_names_beyond_the_first_are_counted() -> None:
    assert listed([]) == ""
    assert listed(["a", "b"], 2) == "a, b"
    assert listed(["a", "b", "c", "d"], 2) == "a, b and 2 more"
    assert listed([str(k) for k in range(13)]).endswith("10, 11 and 1 more")


def test_one_thing_and_several() -> None:
    assert [counted(n, "pass", "passes") for n in (0, 1, 2)] == ["0 passes", "1 pass", "2 passes"]
    assert counted(1234, "pair") == "1,234 pairs"


def test_ways_to_turning_points_are_told_where_there_are_any() -> None:
    assert to_turning_points(0, 0.0) == ""
    assert to_turning_points(11) == ", 11 ways to turning points or ends of the log"
    told = ", 1 way to turning points or ends of the log, 1,234 m"
    assert to_turning_points(1, 1234.4) == told


def test_times_are_told_by_the_calendar_or_beyond_it() -> None:
    assert utc(0) == "1970-01-01 00:00:00"
    assert utc(2**62, "%Y-%m-%d %H:%M") == "2116-02-20 23:53"
    assert utc(10**29) == f"second {10**20}"


def test_formulas_are_quoted_and_numbers_are_not() -> None:
    for cell in ("=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", "\t=1", "-dock"):
        assert quoted_formula(cell) == f"'{cell}"
    for cell in ("", "dock", "-1.5", "+3", "-1e-3", "a=b", "{}", ".5"):
        assert quoted_formula(cell) == cell
