"""Options that several commands share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from ..topology.errors import TopobatchError
from .workspace import MERGED, USUAL, Workspace

WorkspaceOption = Annotated[
    Path,
    typer.Option(
        "--workspace",
        "-w",
        envvar="TOPOBATCH_WORKSPACE",
        help="Folder of the results.",
        file_okay=False,
    ),
]
DEFAULT_WORKSPACE = USUAL

QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show errors only: no progress, no summary.")
]

MergeOption = Annotated[
    str,
    typer.Option("--merge", metavar="NAME", help="The merge to use, by its --output NAME."),
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]

VerboseOption = Annotated[bool, typer.Option("--verbose", "-v", help="Print what is being done.")]


def complete_run(ctx: typer.Context, incomplete: str) -> list[str]:
    """Runs of the workspace with this prefix, for shell completion."""
    named = ctx.params.get("workspace") or os.environ.get("TOPOBATCH_WORKSPACE")
    try:
        runs = Workspace(Path(named or DEFAULT_WORKSPACE)).runs()
    except (TopobatchError, OSError):
        return []
    return [run for run in runs if run.startswith(incomplete) and run.isprintable()]


def complete_map(ctx: typer.Context, incomplete: str) -> list[str]:
    """The same, and the merged map."""
    merged = [MERGED] if MERGED.startswith(incomplete) else []
    return [*merged, *complete_run(ctx, incomplete)]
