"""Groups of options: what several commands take stands once, as the fields of a dataclass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints

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
