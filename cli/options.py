"""Options that several commands share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from ..topology.errors import TopobatchError
from .workspace import USUAL, Workspace


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

FalseMergeRate = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE",
        min=1e-9,
        max=0.5,
        help="Share of batches that may hold any false merge; default 0.001.",
    ),
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


Command = Callable[..., None]


def grouped(command: Command) -> Command:
    """The command with the fields of parameters that are dataclasses in place of these, as typer
    takes them: each an option, annotated and with its default."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {k: hint for k, hint in hints.items() if is_dataclass(hint)}

    @wraps(command)
    def called(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        command(**given)

    parameters = list(_parameters(command, hints, groups))
    called.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {each.name: each.annotation for each in parameters}
    return called


def _parameters(
    command: Command, hints: dict[str, Any], groups: dict[str, Any]
) -> Iterator[Parameter]:
    for name, own in signature(command).parameters.items():
        if name not in groups:
            yield own.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[name])
            continue
        of_group = get_type_hints(groups[name], include_extras=True)
        for field in fields(groups[name]):
            yield Parameter(
                field.name,
                Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=of_group[field.name],
            )
