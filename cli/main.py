"""The `topobatch` command.

Exit codes: 0 all was done, if with warnings; 1 the data is at fault (some or all of it); 2 the call
is at fault; 70 topobatch itself is at fault; 130 interrupted (128 + N by signal N).
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from ..topology.errors import TopobatchError, UsageError
from .output import complain, say, say_lines, show
from .process import lack_of_memory
from .version import VERSION

EXIT_DATA, EXIT_USAGE, EXIT_SOFTWARE = 1, 2, 70
"""Invalid data; invalid call (as click); a bug (EX_SOFTWARE of sysexits.h)."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Linear algebra runs on one thread: matrices are small, and the number of threads changes the last
bits of results. Several cores are used by several processes."""

COMMANDS = {
    "init": ("init.init", "Have a workspace remember options."),
    "ingest": ("ingest.ingest", "Turn logs into topological maps, one per run."),
    "merge": ("merge.merge", "Merge the maps of many runs, where they overlap."),
    "view": ("view.view", "Open a map in the rerun viewer."),
    "draw": ("draw.draw", "Draw a map, the merged map, or the decision on a pair of runs."),
    "report": ("report.report", "Write a page about all runs and their merge, for a browser."),
    "list": ("listing.list_runs", "List the runs of the workspace, by site."),
    "info": ("info.info", "Show what logs hold and what ingest would use."),
    "explain": ("explain.explain", "Explain why two runs were merged, or not."),
    "export": ("export.export", "Write a map in a format that others load."),
    "transfer": ("transfer.transfer", "Carry named places from one map to another."),
    "changes": ("changes.changes", "Tell what changed between the runs that were merged."),
    "next": ("next_drives.next_drives", "Tell what to record next, to join more runs."),
    "site": ("decisions.site", "Name sites: the places where merged runs were recorded."),
    "lock": ("decisions.lock", "Say that two runs belong together, or never do."),
    "discard": ("decisions.discard", "Take back runs, or matches of two runs."),
    "rename": ("decisions.rename", "Give a run another name."),
    "history": ("journal.history", "Show what was done to the workspace."),
    "simulate": ("simulate.simulate", "Write logs of simulated robots, to try things out on."),
    "schema": ("schema.schema", "Print the JSON Schema of a document."),
}  # fmt: skip
"""Where each command is, and what it does in short: its module is loaded when it is called, so that
`--help` answers at once."""


class Sectioned(TyperCommand):
    """A command whose help has the options of a panel in a section of their own, after the
    others."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and options."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for param in self.get_params(ctx):
            kind = f"{param.param_type_name.capitalize()}s"
            title = getattr(param, "rich_help_panel", None) or kind
            if (record := param.get_help_record(ctx)) is not None:
                sections.setdefault(title, []).append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


# Plain help: rich's boxes would double the time that `--help` takes.
STYLE: dict[str, Any] = {
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "add_completion": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


def command_named(name: str) -> Any:
    """A command by its name."""
    home, _, function = COMMANDS[name][0].partition(".")
    alone = typer.Typer(**STYLE)
    alone.command(name, cls=Sectioned)(getattr(import_module(f".{home}", __package__), function))
    return typer.main.get_command(alone)


class Commands(TyperGroup):
    """All commands: their names and summaries, and each itself when it is called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """The command that the first argument names, and the further arguments."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command and command_named(str(name)), rest


app = typer.Typer(
    name="topobatch",
    cls=Commands,
    no_args_is_help=True,
    epilog="Start with: topobatch ingest run1.mcap run2.bag; topobatch merge --all; "
    "topobatch report",
    **STYLE | {"add_completion": True},
)
for each, (_, summary) in COMMANDS.items():
    app.command(each, help=summary)(lambda: None)


def _version(wanted: bool) -> None:
    if wanted:
        say(f"topobatch {VERSION}")
        raise typer.Exit


@app.callback()
def topobatch(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Turn recorded robot runs into topological maps, and merge the maps of many runs.

    Reads MCAP files, ROS 1 bags and ROS 2 bag folders: odometry with junction detections, laser
    scans or clouds of points; and grids, also as saved maps. Runs need no common frame; for every
    pair of runs topobatch says how sure it is that they overlap. Results land in a workspace
    folder: maps/RUN.json, maps/RUN.rrd, merged.json, merged.rrd.
    """


def _say_what_is_wrong(error: TyperException) -> None:
    """An invalid call as one line; without arguments, the help."""
    text = error.format_message()
    if text.startswith("Usage:"):
        say_lines(text.rstrip("\n"), err=True)
        return
    context = getattr(error, "ctx", None)
    named = [word for word in sys.argv[1:2] if word in COMMANDS]  # where click does not say
    command = getattr(context, "command_path", " ".join(("topobatch", *named)))
    line = " ".join(text.split()).removesuffix(".")
    line = line.replace(": Value error, ", ": ").replace(": Input should be ", ": must be ")
    see = "" if line.endswith("?") else ";"
    complain(f"{line[:1].lower()}{line[1:]}{see} see `{command} --help`")


def main() -> None:
    """Run the command line and turn errors into messages and exit codes."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # names and arrows in an encoding without them
    show()
    try:
        sys.exit(app(prog_name="topobatch", standalone_mode=False))
    except TyperException as error:
        _say_what_is_wrong(error)
        sys.exit(error.exit_code)
    except TopobatchError as error:
        complain(str(error))
        sys.exit(EXIT_USAGE if isinstance(error, UsageError) else EXIT_DATA)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        complain(f"{where}{error.strerror or error}")
        sys.exit(EXIT_DATA)
    except Exception as error:
        if os.environ.get("TOPOBATCH_DEBUG"):
            raise
        if lacking := lack_of_memory(error):
            complain(lacking)
            sys.exit(EXIT_DATA)
        complain(
            f"internal error, please report it: {type(error).__name__}: {error} "
            "(set TOPOBATCH_DEBUG=1 to see where)"
        )
        sys.exit(EXIT_SOFTWARE)
