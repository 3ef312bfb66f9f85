"""What the command shows: lines, tables, errors and progress bars.

Results go to the standard output; progress, warnings and errors to the standard error. Away from
a terminal there are no bars and no colours, only lines.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer


def complain(message: str) -> None:
    """An error, on the standard error."""
    typer.echo(typer.style("error: ", fg="red", bold=True) + message, err=True)


def warn(message: str) -> None:
    """A warning, on the standard error."""
    typer.echo(typer.style("warning: ", fg="yellow") + message, err=True)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "  ") -> list[str]:
    """Lines of a table with left-aligned columns as wide as their longest cell."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    return [
        (indent + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True))).rstrip()
        for row in [header, *rows]
    ]


def count(number: int, singular: str, plural: str | None = None) -> str:
    """ "1 junction", "2 junctions"."""
    return f"{number:,} {singular if number == 1 else plural or singular + 's'}"


class Screen:
    """Lines and, on a terminal, one progress bar below them."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self._progress: Any = None
        self._task: Any = None

    def line(self, text: str) -> None:
        """A line of the result, above the bar if there is one."""
        if not self.quiet:
            self._emit(text, err=False)

    def warn(self, message: str) -> None:
        """A warning; --quiet silences it, for it is in the documents too."""
        if not self.quiet:
            self._emit(f"warning: {message}", err=True)

    def complain(self, message: str) -> None:
        """An error; never silenced."""
        self._emit(f"error: {message}", err=True)

    def _emit(self, text: str, *, err: bool) -> None:
        if self._progress is not None:
            self._progress.console.print(text, markup=False, highlight=False, soft_wrap=True)
        else:
            typer.echo(text, err=err)

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
