"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
DEFAULT_WORKSPACE = Path("topobatch-workspace")

QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show errors only: no progress, no summary.")
]
