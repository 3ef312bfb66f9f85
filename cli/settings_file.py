"""`settings.toml` of a workspace: options that its commands take where a call does not give them.

A call's own options come first, then environment variables, then this file, then the defaults.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from difflib import get_close_matches
from typing import Any

import typer
from typer.exceptions import TyperException

from ..topology.errors import DocumentError
from .read_options import MapOptions, ReadOptions
from .workspace import Workspace

NAMES = (
    *(field.name for group in (ReadOptions, MapOptions) for field in fields(group)),
    "false_merge_rate",
)
"""Parameters of commands that a workspace may remember: what the robots are like, and how sure a
merge has to be. In the file they are called like the options."""


def settings_of(place: Workspace) -> dict[str, str]:
    """What a workspace remembers, by parameter, as its options take it; DocumentError with the
    place of the first fault if the file cannot be used."""
    from ..topology.files import read_bytes

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
            raise DocumentError(f"{path}: knows no {key!r}{near or f'; there are: {_all(known)}'}")
    return {known[key]: _text(value, f"{path}: {key}") for key, value in found.items()}


def _all(known: Mapping[str, str]) -> str:
    return ", ".join(known)


def _option(name: str) -> str:
    return name.replace("_", "-")


def _text(value: Any, where: str) -> str:
    """A value as its option takes it: several numbers are joined by commas."""
    several = value if isinstance(value, list) else [value]
    if not all(type(part) in (str, int, float, bool) for part in several):
        raise DocumentError(f"{where}: text, number, true, false or a list of numbers expected")
    return ",".join(str(part) for part in several)


def settings_text(settings: Mapping[str, Any]) -> str:
    """The file that states these settings; inverse of `settings_of`."""
    return "".join(
        f"{_option(name)} = {_quoted(settings[name])}\n" for name in NAMES if name in settings
    )


def _quoted(value: Any) -> str:
    """A text or a number as TOML has it: like JSON, without surrogates, and DEL is escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def told_settings(settings: Mapping[str, str]) -> str:
    """The settings in one line; "" without any."""
    return ", ".join(f"{_option(name)} = {value}" for name, value in settings.items())


def by_settings(place: Workspace) -> str:
    """What follows the line of a call in the journal: the settings that it could take."""
    told = told_settings(settings_of(place))
    return f"; {place.settings_toml.name}: {told}" if told else ""


def use_settings(context: typer.Context, place: Workspace) -> None:
    """Make what a workspace remembers the defaults of a command's options. DocumentError if one of
    them does not take its value."""
    settings = settings_of(place)
    own = {param.name: param for param in context.command.params}
    for name, value in settings.items():
        if name in own:
            try:
                own[name].process_value(context, value)
            except TyperException as error:
                why = f"{_option(name)}: {error.format_message()}"
                raise DocumentError(f"{place.settings_toml}: {why}") from error
    context.default_map = {name: value for name, value in settings.items() if name in own}
