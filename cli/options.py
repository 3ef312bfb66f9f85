"""Options that several commands share, and `settings.toml` of a workspace: options that its
commands take where a call does not give them.

A call's own options come first, then environment variables, then that file, then the defaults.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, Signature, isfunction, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.exceptions import TyperException

from ..topology.errors import DocumentError, TopobatchError
from ..topology.files import read_bytes
from .read_options import MapOptions, ReadOptions
from .workspace import MERGED, USUAL, Workspace

Command = Callable[..., None]


def verb(command: Command) -> Command:
    """The command as typer takes it: in place of a parameter that is made of several options, a
    dataclass or annotated with the function that makes it, these: each annotated and with its
    default."""
    hints = get_type_hints(command, include_extras=True)
    made = {name: _maker(hint) for name, hint in hints.items()}

    @wraps(command)
    def called(**given: Any) -> None:
        for name, maker in made.items():
            if maker is not None:
                options = {own: given.pop(own) for own in signature(maker).parameters}
                given[name] = maker(**options)
        command(**given)

    parameters = []
    for name, own in signature(command).parameters.items():
        maker = made[name]
        several = {name: own} if maker is None else signature(maker).parameters
        kinds = hints if maker is None else get_type_hints(maker, include_extras=True)
        parameters += [
            each.replace(kind=Parameter.KEYWORD_ONLY, annotation=kinds[option])
            for option, each in several.items()
        ]
    called.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {each.name: each.annotation for each in parameters}
    return called


def _maker(hint: Any) -> Callable[..., Any] | None:
    """What makes a parameter of several options; None if it is an option itself."""
    if is_dataclass(hint):
        return hint  # type: ignore[return-value]
    return next(filter(isfunction, getattr(hint, "__metadata__", ())), None)


def _with_settings(context: typer.Context, workspace: Path) -> Path:
    """The workspace, with what it remembers as the defaults of the command's other options.
    DocumentError if one of them does not take its value."""
    if context.resilient_parsing:
        return workspace
    place = Workspace(workspace)
    own = {param.name: param for param in context.command.params}
    settings = {name: value for name, value in settings_of(place).items() if name in own}
    for name, value in settings.items():
        try:
            own[name].process_value(context, value)
        except TyperException as error:
            why = f"{_option(name)}: {error.format_message()}"
            raise DocumentError(f"{place.settings_toml}: {why}") from error
    context.default_map = settings
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

MergeOption = Annotated[
    str,
    typer.Option("--merge", metavar="NAME", help="The merge to use, by its --output NAME."),
]


def _place(workspace: WorkspaceOption = USUAL) -> Workspace:
    return Workspace(workspace)


def _place_of_merge(workspace: WorkspaceOption = USUAL, merge: MergeOption = MERGED) -> Workspace:
    return Workspace(workspace, merge)


Here = Annotated[Workspace, _place]
HereWithMerge = Annotated[Workspace, _place_of_merge]
"""The workspace that a command is about, with one of its merges."""

QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show errors only: no progress, no summary.")
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
        runs = Workspace(Path(named or USUAL)).runs()
    except (TopobatchError, OSError):
        return []
    return [run for run in runs if run.startswith(incomplete) and run.isprintable()]


NAMES = (
    *(field.name for group in (ReadOptions, MapOptions) for field in fields(group)),
    "false_merge_rate",
)
"""Parameters of commands that a workspace may remember: what the robots are like, and how sure a
merge has to be. In the file they are called like the options."""


def settings_of(place: Workspace) -> dict[str, str]:
    """What a workspace remembers, by parameter, as its options take it; DocumentError with the
    place of the first fault if the file cannot be used."""
    path = place.settings_toml
    try:
        found = tomllib.loads(read_bytes(path).decode())
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (ValueError, RecursionError) as error:
        raise DocumentError(f"{path}: is no TOML: {error}") from error
    known = {_option(name): name for name in NAMES}
    for key in found:
        if key not in known:
            near = "".join(f"; did you mean {k!r}?" for k in get_close_matches(key, known, 1))
            there = near or f"; there are: {', '.join(known)}"
            raise DocumentError(f"{path}: knows no {key!r}{there}")
    return {known[key]: _text(value, f"{path}: {key}") for key, value in found.items()}


def _option(name: str) -> str:
    return name.replace("_", "-")


def _text(value: Any, where: str) -> str:
    """A value as its option takes it: several numbers are joined by commas."""
    several = value if isinstance(value, list) else [value]
    if not all(type(part) in (str, int, float, bool) for part in several):
        raise DocumentError(f"{where}: text, number, true, false or a list of numbers expected")
    return ",".join(str(part) for part in several)


def settings_text(settings: Mapping[str, Any]) -> str:
    """The file that states these settings; inverse of `settings_of`. Texts and numbers are in TOML
    as in JSON, but that DEL is escaped."""
    texts = {
        name: json.dumps(settings[name], ensure_ascii=False).replace("\x7f", "\\u007f")
        for name in NAMES
        if name in settings
    }
    return "".join(f"{_option(name)} = {text}\n" for name, text in texts.items())


def told_settings(settings: Mapping[str, Any]) -> str:
    """The settings in one line; "" without any."""
    return ", ".join(f"{_option(name)} = {value}" for name, value in settings.items())


def by_settings(place: Workspace) -> str:
    """What follows the line of a call in the journal: the settings that it could take."""
    told = told_settings(settings_of(place))
    return f"; {place.settings_toml.name}: {told}" if told else ""
