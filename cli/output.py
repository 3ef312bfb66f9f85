"""The command's output: lines, tables, errors and a progress bar.

Results go to standard output; progress, warnings and errors to standard error. Without a terminal
there are no bars and no colours, and with NO_COLOR (no-color.org) no colours.

All output passes through this module, and no other writes to a stream: names of files, topics and
types are untrusted, and control characters are escaped.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import typer

from ..topology.errors import DataError, UsageError
from ..topology.wording import folded as wrapped

WIDTH, NARROWEST = 79, 40
"""Line width of sentences where no terminal tells its own, and its least: tables need as much."""

LEAST_FOR_AMOUNTS = 60
"""Columns of a terminal that hold the longest of these ("12/22 logs, 123.4 of 456.7 MB"), the time
left and a short bar."""

COLOURS = {
    "merged": "green",
    "joined through others": "green",
    "ambiguous": "yellow",
    "unrelated": "bright_black",
    "kept out": "red",
}
"""Colours of verdicts on a terminal."""

_VERDICT = re.compile(rf"(?<![\w./-])(?<!not )({'|'.join(COLOURS)})(?![\w./-])")

LONGEST_LINE = 8000
"""Characters; names can have millions."""


@dataclass(slots=True)
class _Call:
    """How the running command shows what it does. bar: rich's, below which lines are printed;
    settings: of its workspace, a file, and what gives the options that the command took from it."""

    quiet: bool = False
    verbose: bool = False
    started_s: float = 0.0
    bar: Any = None
    settings: tuple[Path, Callable[[], Iterable[str]]] | None = None


_call = _Call()


def show(*, quiet: bool = False, verbose: bool = False) -> None:
    """Begin the output of a command. quiet: errors, and what it prints for other programs, alone;
    verbose: details as well."""
    _call.quiet, _call.verbose, _call.started_s = quiet, verbose, time.monotonic()


def is_verbose() -> bool:
    """Whether details are shown."""
    return _call.verbose


def plain(text: str, most: int = LONGEST_LINE) -> str:
    r"""The text on one line in printable characters, cut at `most`.

    Control characters, line breaks, marks of writing direction and surrogates are escaped (as \x1b,
    \n, \u202e, \ud800). Plain text is returned as it is.
    """
    if len(text) > most:
        text = f"{text[:most]}… ({len(text) - most:,} more characters)"
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii")
        for c in text
    )


def styled(text: str, **style: Any) -> str:
    """The text in a colour, which goes where there is no terminal, or with NO_COLOR."""
    return text if os.environ.get("NO_COLOR") else typer.style(text, **style)


def painted(text: str) -> str:
    """The printable text with its verdicts in colour."""
    return _VERDICT.sub(lambda found: styled(found[0], fg=COLOURS[found[0]]), text)


def width() -> int:
    """Width of lines: that of the terminal, or by COLUMNS, if it is not too narrow."""
    return max(shutil.get_terminal_size((WIDTH + 1, 0)).columns - 1, NARROWEST)


def say(text: str = "") -> None:
    """Print a line of the result, unless --quiet."""
    if not _call.quiet:
        _emit(painted(plain(text)))


def say_folded(text: str, indent: str = "      ") -> None:
    """Print a long line of the result as several."""
    for line in folded(text, indent):
        say(line)


def say_row(line: str) -> None:
    """Print a line of a table; on a terminal folded, for other programs on one line."""
    (say_folded if sys.stdout.isatty() else say)(line)


def folded(text: str, indent: str = "      ") -> list[str]:
    """A long line as several of at most `width` letters, indented from the second on."""
    return wrapped(plain(text), width(), rest=indent)


def detail(text: str) -> None:
    """Print what is being done, with the seconds since the start; with --verbose only."""
    if _call.verbose:
        tell(f"[{time.monotonic() - _call.started_s:.1f} s] {text}")


def tell(text: str) -> None:
    """Print what happens meanwhile, on standard error, unless --quiet."""
    if not _call.quiet:
        _emit(painted(plain(text)), err=True)


def begin(text: str) -> None:
    """Print that a long task begins, where no bar shows it."""
    if not sys.stderr.isatty():
        tell(text)


def warn(message: str) -> None:
    """Print a warning, unless --quiet: it is in the documents too."""
    if not _call.quiet:
        _emit(styled("warning: ", fg="yellow") + plain(message), err=True)


def complain(message: str) -> None:
    """Print an error; of options that it names and the call does not, where they are set."""
    _emit(styled("error: ", fg="red", bold=True) + plain(f"{message}{_set_in(message)}"), err=True)


def remember(path: Path, taken: Callable[[], Iterable[str]]) -> None:
    """Have errors name the file that sets an option. taken: gives the options ("--time") that the
    command took from it."""
    _call.settings = path, taken


def _set_in(message: str) -> str:
    """Which options that a message names are set in the file of settings; "" if none is."""
    path, taken = _call.settings or ("", tuple)
    named = [each for each in taken() if re.search(rf"{each}(?![\w-])", message)]
    are = "is" if len(named) == 1 else "are"
    return f"; {' and '.join(named)} {are} set in {path}" if named else ""


def _emit(line: str, *, err: bool = False) -> None:
    if _call.bar is not None and (err or sys.stdout.isatty()):
        from rich.text import Text

        _call.bar.console.print(Text.from_ansi(line), highlight=False, soft_wrap=True)
    else:
        typer.echo(line, err=err)


def say_lines(text: str, *, err: bool = False) -> None:
    """Print what was asked for as several lines of any length, also with --quiet."""
    for line in text.split("\n"):
        typer.echo(plain(line, len(line)), err=err)


def say_json(value: Any) -> None:
    """Print a value as JSON on one line, also with --quiet."""
    say_lines(json.dumps(value))


def say_text(text: str) -> None:
    """Print a file's content unchanged for other programs; on a terminal escaped."""
    if sys.stdout.isatty():
        say_lines(text.removesuffix("\n"))
    else:
        typer.echo(text.encode(), nl=False)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "  ") -> list[str]:
    """Lines of a table with left-aligned columns."""
    shown = [[plain(cell) for cell in row] for row in [header, *rows]]
    widths = [max(len(row[i]) for row in shown) for i in range(len(header))]
    return [
        (indent + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True))).rstrip()
        for row in shown
    ]


def checked_output(path: Path) -> Path:
    """The path of a file to write; UsageError for what is none: a device, a FIFO or a socket, also
    by a link, which a file would take the place of."""
    folder = path.parent.resolve()
    system = folder == Path("/dev") or Path("/proc") in (folder, *folder.parents)
    if system or (os.path.exists(path) and not path.is_file() and not path.is_dir()):
        raise UsageError(f"{path}: is no file that could be written; name another")
    return path


def write_files(files: Mapping[Path, str | bytes]) -> None:
    """Write files that the user named, all of them or none."""
    from ..topology.files import write_together

    data = {path: t.encode() if isinstance(t, str) else t for path, t in files.items()}
    try:
        write_together({path: partial(Path.write_bytes, data=d) for path, d in data.items()})
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        raise DataError(f"{error.filename}: {error.strerror}; name another file") from error


class Advance(Protocol):
    """Sets how much is done; words: in words, instead of counts; doing: what is done now; kept: how
    much of that was done before, and says nothing of the speed."""

    def __call__(self, done: int, words: str = "", doing: str = "", kept: int = 0) -> None:
        """Show it."""


def megabytes(size: float) -> str:
    """A number of bytes in megabytes, without the unit."""
    return f"{size / 1e6:,.1f}"


def counting(advance: Callable[[int], object]) -> Callable[[int], None]:
    """A function that is told how much more is done, from one that is told how much is."""
    done = 0

    def more(amount: int) -> None:
        nonlocal done
        done += amount
        advance(done)

    return more


@contextmanager
def progress(label: str, total: int, unit: str = "") -> Iterator[Advance]:
    """Context with a progress bar, below all lines; the yielded function sets the progress so far.

    total: 0 where nobody knows; unit: "bytes" or a plural noun, of what is counted. Nothing is
    drawn with --quiet or without a terminal.
    """
    if _call.quiet or not sys.stderr.isatty():
        yield lambda done, words="", doing="", kept=0: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column

    what, amount = (
        TextColumn(f"{{task.{name}}}", markup=False) for name in ("description", "fields[amount]")
    )
    whole = Column(no_wrap=True)  # so that the bar is what is narrower
    clock = (
        TimeRemainingColumn(elapsed_when_finished=True, table_column=whole)
        if total
        else TimeElapsedColumn(table_column=whole)
    )
    console = Console(stderr=True)
    amounts = (amount,) if console.width >= LEAST_FOR_AMOUNTS else ()
    columns = (what, BarColumn(), *amounts, TextColumn("left:" if total else ""), clock)
    bar = Progress(*columns, console=console, transient=True)
    task = bar.add_task(label, total=total or None, amount="")

    def advance(done: int, words: str = "", doing: str = "", kept: int = 0) -> None:
        if unit and not words and not doing:
            in_bytes = f"{megabytes(done)} of {megabytes(total)} MB"
            words = in_bytes if unit == "bytes" else f"{done:,} of {total:,} {unit}"
        # The time left goes by the fresh work alone.
        bar.update(task, total=max(total - kept, 0) or None, completed=done - kept)
        bar.update(task, amount=words, description=doing or label)

    with bar:
        _call.bar = bar
        try:
            yield advance
        finally:
            _call.bar = None
