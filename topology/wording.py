"""Names and numbers in messages."""

from __future__ import annotations

from collections.abc import Sequence

MOST_NAMES = 12
"""As many names of usual length as two lines of a terminal hold."""


def listed(names: Sequence[str], most: int = MOST_NAMES) -> str:
    """Names in one line: the first `most` of them, and how many more there are."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """ "1 junction", "2 junctions"."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"
