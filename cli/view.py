"""`topobatch view`: open a recording in the rerun viewer."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer

from ..topology.errors import DataError, UsageError
from .options import RUNS, Extra, Here, verb
from .output import say
from .workspace import MERGED, Workspace

HOST = "127.0.0.1"
"""Where the viewer is served: to this machine alone."""


@verb
def view(
    what: Annotated[
        str,
        "[RUN]",
        "Run whose map to open, or the --output NAME of a merge; the merged map without.",
        RUNS,
        Extra(show_default=False),
    ] = MERGED,
    *,
    place: Here,
    web: Annotated[
        bool, "--web", "Serve the viewer to browsers of this machine instead, until Ctrl-C."
    ] = False,
    port: Annotated[
        int,
        "--port N",
        "With --web: port of the page, N + 1 that of the data.",
        Extra(min=1, max=65534),
    ] = 9090,
) -> None:
    """Open the merged map, or a run's, in the rerun viewer.

    Drag the time line below a run's map: the robot drives on it. The viewer opens MCAP logs as
    well: rerun maps/RUN.rrd run.mcap.

    --web serves rerun's viewer on 127.0.0.1, also where there is no display, and prints the page's
    address. From another machine: ssh -L 9090:127.0.0.1:9090 -L 9091:127.0.0.1:9091.

    \b
      topobatch view
      topobatch view run1
      topobatch view --web
    """
    recording = _recording(place, what)
    screens = sys.platform in ("darwin", "win32")
    if web:
        _serve(recording, port)
    elif screens or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        raise typer.Exit(subprocess.call([sys.executable, "-m", "rerun", str(recording)]))
    else:
        say(f"{recording}: there is no display here. To look at it:")
        by_hand = f"rerun {shlex.quote(recording.name)}   (pip install rerun-sdk)"
        say(f"  on a machine with a screen:  {by_hand}")
        served = place.call("view", *([] if what == MERGED else [what]), "--web")
        say(f"  in a browser:  {served}")


def _recording(place: Workspace, what: str) -> Path:
    """The recording to open, of a site that of its merge; UsageError or DataError if there is
    none."""
    found = place.named(what)
    if found.run is not None:
        recording, how = place.map_rrd(found.run), f"ingest the log of {found.run} again"
    elif found.pair is not None:
        drawn = place.call("draw", what, "why.svg")
        raise UsageError(f"a pair of runs has no recording; its picture: {drawn}")
    else:
        recording, how = found.place.merged_rrd, "merge again"
        if not recording.is_file():
            found.place.require_merge()
    if not recording.is_file():
        raise DataError(f"{recording}: is not there; {how}")
    return recording


def _serve(recording: Path, port: int) -> None:
    """Serve a recording and rerun's viewer on 127.0.0.1 until Ctrl-C. UsageError if it
    ends with an error: where a port is taken, rerun itself may say nothing."""
    source = quote(f"rerun+http://{HOST}:{port + 1}/proxy", safe="")
    say(f"http://{HOST}:{port}/?url={source}  (Ctrl-C ends it)")
    sys.stdout.flush()
    ports = ("--bind", HOST, "--web-viewer-port", str(port), "--port", str(port + 1))
    # Rerun reports its use over the network unless it runs for CI.
    environment = {**os.environ, "CI": "1", "RUST_LOG": "error"}
    with suppress(KeyboardInterrupt):
        call = [_viewer(), "--serve-web", *ports, str(recording)]
        if subprocess.call(call, env=environment):
            raise UsageError(
                f"ports {port} and {port + 1} cannot be served on; name another --port"
            )


def _viewer() -> str:
    """The program of the viewer, without the Python process around it, which would outlive this
    one."""
    from importlib.resources import files

    folder = Path(str(files("rerun_cli")))
    places = (folder, folder / "Rerun.app" / "Contents" / "MacOS")
    found = shutil.which("rerun", path=os.pathsep.join(map(str, places)))
    if found is None:
        raise DataError(f"{folder}: rerun's viewer is not there; install rerun-sdk again")
    return found
