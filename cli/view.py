"""`topobatch view`: open a recording in the rerun viewer."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from ..topology.errors import DataError
from .options import DEFAULT_WORKSPACE, WorkspaceOption, complete_run
from .output import say
from .workspace import Workspace, shortened


def view(
    run: Annotated[
        str | None,
        typer.Argument(
            help="Run whose map to open, or the --output NAME of a merge; the merged map without.",
            autocompletion=complete_run,
        ),
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
) -> None:
    """Open the merged map, or a run's, in the rerun viewer."""
    place = Workspace(workspace)
    recording = place.merged_rrd if run is None else place.map_rrd(run)
    if (
        run is not None
        and not recording.is_file()
        and Workspace(workspace, run).merged_json.is_file()
    ):
        recording = Workspace(workspace, run).merged_rrd
    if not recording.is_file():
        if run is None:
            raise DataError(f"{recording}: is not there yet; make it with `topobatch merge --all`")
        known = shortened(place.runs()) or "none"
        raise DataError(f"{recording}: is not there; runs with a map: {known}")
    if not _has_display():
        say(f"{recording}: there is no display here. To look at it:")
        say(f"  on a machine with a screen:  rerun {recording.name}   (pip install rerun-sdk)")
        say(f"  in a browser, served by this machine:  rerun --web-viewer {recording}")
        return
    import subprocess

    raise typer.Exit(subprocess.call([sys.executable, "-m", "rerun", str(recording)]))


def _has_display() -> bool:
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
