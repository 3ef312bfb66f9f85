"""What the command shows: lines, tables, errors and progress bars.

Results go to the standard output; progress, warnings and errors to the standard error. Away from
a terminal there are no bars and no colours, only lines.

Everything that the command shows goes through `say`, and no other module writes to a stream: names
of files, topics and types come from others, and what would steer a terminal is shown escaped.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from textwrap import wrap
from typing import Any

import typer

WIDTH = 79
"""Letters in a line of advice: the smallest usual terminal."""

LONGEST_LINE = 8000
LONGEST_CELL = 200
"""Characters. A name can have millions of them, and pads every row of a table."""


def plain(text: str, most: int = LONGEST_LINE) -> str:
    """The text in printable characters, on one line, and not without end.

    Escaped are control characters, line breaks, marks that turn the direction of writing, halves of
    characters (as \\x1b, \\n, \\u202e, \\ud800). Text that is plain already is returned as it is.
    """
    if len(text) > most:
        text = f"{text[:most]}… ({len(text) - most:,} more characters)"
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")


def say(text: str = "", *, err: bool = False) -> None:
    """One line, on the standard output or the standard error."""
    typer.echo(plain(text), err=err)


def say_lines(text: str, *, err: bool = False) -> None:
    """A text of several lines, as long as they are."""
    for line in text.split("\n"):
        typer.echo(plain(line, len(line)), err=err)


def folded(text: str, indent: str = "      ") -> list[str]:
    """A long line as several of WIDTH letters at most, all but the first indented."""
    return wrap(
        plain(text),
        WIDTH,
        subsequent_indent=indent,
        drop_whitespace=True,
        break_long_words=False,
        break_on_hyphens=False,
    )


def complain(message: str) -> None:
    """An error, on the standard error."""
    typer.echo(typer.style("error: ", fg="red", bold=True) + plain(message), err=True)


def warn(message: str) -> None:
    """A warning, on the standard error."""
    typer.echo(typer.style("warning: ", fg="yellow") + plain(message), err=True)


def say_text(text: str) -> None:
    """A file for the next program, as it is; on a terminal like everything that is shown."""
    if sys.stdout.isatty():
        say_lines(text.removesuffix("\n"))
    else:
        typer.echo(text.encode(), nl=False)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "  ") -> list[str]:
    """Lines of a table with left-aligned columns as wide as their longest cell."""
    shown = [[plain(cell, LONGEST_CELL) for cell in row] for row in [header, *rows]]
    widths = [max(len(row[i]) for row in shown) for i in range(len(header))]
    return [
        (indent + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True))).rstrip()
        for row in shown
    ]


class Screen:
    """Lines and, on a terminal, one progress bar below them."""

    def __init__(self, quiet: bool, verbose: bool = False) -> None:
        self.quiet = quiet
        self.verbose = verbose
        self._started = time.monotonic()
        self._progress: Any = None

    def line(self, text: str) -> None:
        """A line of the result, above the bar if there is one."""
        if not self.quiet:
            self._emit(text, err=False)

    def detail(self, text: str) -> None:
        """What happens meanwhile, with the seconds since the start; only if it was asked for."""
        if self.verbose:
            self._emit(f"[{time.monotonic() - self._started:.1f} s] {text}", err=True)

    def warn(self, message: str) -> None:
        """A warning; --quiet silences it, for it is in the documents too."""
        if not self.quiet:
            self._emit(f"warning: {message}", err=True)

    def complain(self, message: str) -> None:
        """An error; never silenced."""
        self._emit(f"error: {message}", err=True)

    def _emit(self, text: str, *, err: bool) -> None:
        if self._progress is not None and (err or sys.stdout.isatty()):
            self._progress.console.print(plain(text), markup=False, highlight=False, soft_wrap=True)
        else:
            say(text, err=err)

    @contextmanager
    def progress(self, label: str, total: int, unit: str) -> Iterator[Callable[[int], None]]:
        """A bar while the body runs; the body calls the given function with what is done so far.

        `unit` is "bytes" or a plural noun. Nothing is drawn with --quiet or away from a terminal.
        """
        if self.quiet or not sys.stderr.isatty():
            yield lambda done: None
            return
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            DownloadColumn,
            MofNCompleteColumn,
            Progress,
            ProgressColumn,
            TextColumn,
            TimeRemainingColumn,
        )

        amount: ProgressColumn = DownloadColumn() if unit == "bytes" else MofNCompleteColumn()
        columns = [TextColumn("{task.description}"), BarColumn(), amount]
        tail = [] if unit == "bytes" else [TextColumn(unit)]
        progress = Progress(
            *columns, *tail, TimeRemainingColumn(), console=Console(stderr=True), transient=True
        )
        task = progress.add_task(label, total=max(total, 1))
        with progress:
            self._progress = progress
            try:
                yield lambda done: progress.update(task, completed=done)
            finally:
                self._progress = None
