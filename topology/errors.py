"""The one error family of the library.

    TopobatchError
    ├── UsageError       the call is wrong: unknown option, two topics to choose from  (exit 2)
    └── DataError        the input is wrong: no odometry, truncated log, bad document  (exit 1)
        ├── LogError         a log cannot be read or holds nothing to use
        └── DocumentError    a map or merged document does not follow its schema

Every message is one line that says what was found and what to do about it. Only `cli/` turns
these into text on the screen and an exit code.
"""

from __future__ import annotations

from collections.abc import Sequence


class TopobatchError(Exception):
    """Base of everything that this library raises on purpose."""


class UsageError(TopobatchError):
    """The caller asked for something that cannot be: an option, a name, a combination."""


class DataError(TopobatchError):
    """The input itself is at fault."""


class LogError(DataError):
    """A recorded log cannot be read, or holds nothing that can be used."""


class DocumentError(DataError):
    """A map or merged document cannot be read or does not follow its schema."""


def check_choice(option: str, value: object, among: Sequence[object]) -> None:
    """UsageError if an option's value is none of a few."""
    if value not in among:
        raise UsageError(f"{option} is {value!r}, expected {' or '.join(map(str, among))}")
