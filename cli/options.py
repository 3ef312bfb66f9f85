"""Options that several commands share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from ..topology.errors import TopobatchError
from .workspace import MERGED, USUAL, Workspace


def _with_settings(context: typer.Context, workspace: Path) -> Path:
    """The workspace, with what it remembers as the defaults of the command's other options."""
    if not context.resilient_parsing:
        from .settings_file import use_settings

        use_settings(context, Workspace(workspace))
    return workspace


WorkspaceOption = Annotated[
    Path,
    typer.Option(
        "--workspace",
        "-w",
        envvar="TOPOBATCH_WORKSPACE",
        help="Folder of the results.",
        file_okay=False,
        is_eager=True,
        callback=_with_settings,
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

SiteOption = Annotated[
    str | None,
    typer.Option(
        "--site", metavar="NAME", help="Only this site of the merged map (topobatch list)."
    ),
]

ComponentOption = Annotated[
    int | None,
    typer.Option(metavar="N", min=0, help="Only this component of the merged map, by its number."),
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


def complete_site(ctx: typer.Context, incomplete: str) -> list[str]:
    """Sites of the merge with this prefix."""
    named = ctx.params.get("workspace") or os.environ.get("TOPOBATCH_WORKSPACE")
    try:
        graph = Workspace(Path(named or DEFAULT_WORKSPACE)).read_merged().graph
    except (TopobatchError, OSError):
        return []
    return sorted(name for name in {*graph.sites.values()} if name.startswith(incomplete))


def complete_map(ctx: typer.Context, incomplete: str) -> list[str]:
    """The same, the merged map and its sites."""
    merged = [MERGED] if MERGED.startswith(incomplete) else []
    named = [*complete_site(ctx, incomplete), *complete_run(ctx, incomplete)]
    return [*merged, *dict.fromkeys(named)]
