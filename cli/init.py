"""`topobatch init`: what a workspace remembers."""

from __future__ import annotations

from typing import Annotated

import typer

from ..topology.errors import UsageError
from .journal import note
from .options import DEFAULT_WORKSPACE, FalseMergeRate, WorkspaceOption, grouped
from .output import say, warn
from .read_options import MapOptions, ReadOptions
from .settings_file import NAMES, settings_text, told_settings
from .workspace import Workspace


@grouped
def init(
    context: typer.Context,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    read: ReadOptions = ReadOptions(),  # noqa: B008 - frozen
    mapping: MapOptions = MapOptions(),  # noqa: B008 - frozen
    false_merge_rate: FalseMergeRate = None,
    forget: Annotated[
        bool, typer.Option("--forget", help="Forget what it remembered before.")
    ] = False,
) -> None:
    """Have a workspace remember options, so that no call needs to repeat them.

    Written to settings.toml in the workspace, which may be edited by hand; what it remembers
    already stays without --forget. Commands take it where their own options and environment
    variables say nothing. Show it: topobatch info.

    \b
      topobatch init --odometry-topic /odom --laser-pose 0.2,0,0
      topobatch init --false-merge-rate 0.0001
    """
    from ..topology.files import write_text

    place = Workspace(workspace)
    given = {
        name: value
        for name, value in context.params.items()
        if name in NAMES and context.get_parameter_source(name).name in _SAID[forget]  # type: ignore[union-attr]
    }
    for name, value in given.items():
        if isinstance(value, str) and not value.isprintable():
            raise UsageError(f"--{name.replace('_', '-')} is {value!r}, which is no name")
    # Numbers that make no sense are refused here, not by the next call.
    read.settings()
    with place.held(warn):
        write_text(place.settings_toml, settings_text(given))
        note(place, "init", told_settings({k: str(v) for k, v in given.items()}) or "nothing", warn)
    for line in settings_text(given).splitlines():
        say(line)
    say(f"{place.settings_toml}")


_SAID = {False: ("COMMANDLINE", "DEFAULT_MAP"), True: ("COMMANDLINE",)}
"""Where a value comes from that is remembered."""
