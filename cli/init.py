"""`topobatch init`: what a workspace remembers."""

from __future__ import annotations

from typing import Annotated

import typer

from ..topology.errors import UsageError
from ..topology.files import write_text
from .journal import note
from .options import (
    GIVEN,
    REMEMBERED,
    FalseMergeRate,
    Here,
    MapOptions,
    ReadOptions,
    describe_settings,
    flag,
    settings_text,
    taken,
    verb,
)
from .output import say_lines


@verb
def init(
    context: typer.Context,
    place: Here,
    read: ReadOptions,
    mapping: MapOptions,
    false_merge_rate: FalseMergeRate = None,
    forget: Annotated[bool, "--forget", "Forget what it remembered before."] = False,
) -> None:
    """Have a workspace remember options, so that no call needs to repeat them.

    Written to settings.toml in the workspace, which may be edited by hand; what it remembers
    already stays without --forget. Commands take it where their own options and environment
    variables say nothing. Show it: topobatch info.

    \b
      topobatch init --odometry-topic /odom --laser-pose 0.2,0,0
      topobatch init --false-merge-rate 0.0001
    """
    given = taken(context, GIVEN if forget else (*GIVEN, *REMEMBERED))
    for name, value in given.items():
        if isinstance(value, str) and not value.isprintable():
            raise UsageError(f"{flag(name)} is {value!r}, which is no name")
    # Numbers that make no sense are refused here, not by the next call.
    read.settings()
    text = settings_text(given)
    with place.held(make=True):
        write_text(place.settings_toml, text)
        note(place, "init", describe_settings(given) or "nothing")
    say_lines(f"{text}{place.settings_toml}")
