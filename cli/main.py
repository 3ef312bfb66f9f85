"""The `topobatch` command.

Exit codes: 0 all was done, if with warnings; 1 the data is at fault (some or all of it); 2 the call
is at fault; 70 topobatch itself is at fault; 130 interrupted (128 + N by signal N).
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from difflib import get_close_matches
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperCommand
from typer.exceptions import TyperException

from ..topology.errors import TopobatchError, UsageError
from .changes import changes
from .discard import discard
from .draw import draw
from .explain import explain
from .export import export
from .info import info
from .ingest import ingest
from .init import init
from .journal import history
from .listing import list_runs
from .lock import lock
from .merge import merge
from .next_drives import next_drives
from .output import complain, say, say_lines
from .process import lack_of_memory
from .rename import rename
from .report import report
from .schema import schema
from .simulate import simulate
from .site import site
from .transfer import transfer
from .version import VERSION
from .view import view

EXIT_DATA, EXIT_USAGE, EXIT_SOFTWARE = 1, 2, 70
"""Invalid data; invalid call (as click); a bug (EX_SOFTWARE of sysexits.h)."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Linear algebra runs on one thread: matrices are small, and the number of threads changes the last
bits of results. Several cores are used by several processes."""

# Plain help: rich's boxes would double the time that `--help` takes.
app = typer.Typer(
    name="topobatch",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Start with: topobatch ingest run1.mcap run2.bag; topobatch merge --all; topobatch view",
)
COMMANDS: tuple[tuple[str, Callable[..., None]], ...] = (
    ("init", init),
    ("ingest", ingest),
    ("merge", merge),
    ("view", view),
    ("draw", draw),
    ("report", report),
    ("list", list_runs),
    ("info", info),
    ("explain", explain),
    ("export", export),
    ("transfer", transfer),
    ("changes", changes),
    ("next", next_drives),
    ("site", site),
    ("lock", lock),
    ("discard", discard),
    ("rename", rename),
    ("history", history),
    ("simulate", simulate),
    ("schema", schema),
)


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


for name, command in COMMANDS:
    app.command(name, cls=Sectioned)(command)


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
    named = [word for word in sys.argv[1:2] if word in dict(COMMANDS)]  # where click does not say
    command = getattr(context, "command_path", " ".join(("topobatch", *named)))
    line = " ".join(text.split()).removesuffix(".")
    line = line.replace(": Value error, ", ": ").replace(": Input should be ", ": must be ")
    if line.startswith("No such command") and os.path.exists(sys.argv[1]):
        line += f"; did you mean `topobatch ingest {sys.argv[1]}`?"
    if choice := re.search(r"'([^']*)' is not one of ('.+')$", line):
        options = choice[2][1:-1].split("', '")
        near = get_close_matches(choice[1], options, 1, 0.7)
        if choice[1].lower() == "geojson" and "nav2" in options:
            near = ["nav2"]  # whose file is GeoJSON
        line += "".join(f"; did you mean {each!r}?" for each in near)
    see = "" if line.endswith("?") else ";"
    complain(f"{line[:1].lower()}{line[1:]}{see} see `{command} --help`")


def main() -> None:
    """Run the command line and turn errors into messages and exit codes."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # names and arrows in an encoding without them
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
