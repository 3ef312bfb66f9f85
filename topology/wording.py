"""Names, numbers and times in messages."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from textwrap import wrap

MOST_NAMES = 12
"""As many names of usual length as two lines of a terminal hold."""


def utc(time_ns: int, form: str = "%Y-%m-%d %H:%M:%S") -> str:
    """A time in UTC, to the second at most."""
    seconds = time_ns // 10**9
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime(form)
    except (OverflowError, ValueError, OSError):
        return f"second {seconds}"  # a clock far outside of any calendar


_FORMULA = re.compile(r"[=+\-@\t\r\n]")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def quoted_formula(cell: str) -> str:
    """A cell of a CSV table; what spreadsheets may run as a formula gets an apostrophe in front, by
    which they take it for text (OWASP, CSV injection)."""
    runs = _FORMULA.match(cell) and not _NUMBER.fullmatch(cell)
    return f"'{cell}" if runs else cell


def legible(text: str) -> str:
    """The text with unprintable characters, line breaks among them, replaced."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def listed(names: Sequence[str], most: int = MOST_NAMES) -> str:
    """Names in one line: the first `most` of them and the number of the others."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def folded(text: str, width: int, first: str = "", rest: str = "") -> list[str]:
    """A long line as several of at most `width` letters; first, rest: their indentation. Long
    words, paths for instance, stay whole."""
    return wrap(
        text,
        width,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """ "1 junction", "2 junctions"."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def to_turning_points(number: int, length_m: float | None = None) -> str:
    """What follows the corridors, which join two junctions: how many ways lead to none, and their
    length; empty without any."""
    length = "" if length_m is None else f", {length_m:,.0f} m"
    return f", {counted(number, 'way')} without a junction at the end{length}" if number else ""
