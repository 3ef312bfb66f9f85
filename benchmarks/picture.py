"""Makes the picture of the README and the tutorial: the merged sample logs in the real viewer
(`make docs`).

The viewer needs a Vulkan driver, for which one in software will do (Debian: mesa-vulkan-drivers,
libvulkan1), but no display. The picture carries what it shows as text (`shown_by`).
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "merged.png"
SHOWS = "topobatch: shows"
COLOURS = 256
WIDTH = 1400
PANELS = ("ui.toggle_top_panel",)
"""Of the viewer's own, which the picture does without."""

TOP, BOTTOM = 37 / 1080, 1050 / 1080
"""Between these shares of the screen's height are the views: below the window's bar, above time."""

LOADING_S = 60.0
PAINTING_S = 8.0


def facts(merged: Mapping[str, Any]) -> str:
    """What can be seen in the picture of a merged document, one fact per line."""
    lines = []
    for component in merged["graph"]["components"]:
        nodes = [n for n in merged["nodes"] if n["component"] == component["id"]]
        shared = sum(len(n["members"]) > 1 for n in nodes)
        runs = ", ".join(sorted(component["runs"]))
        lines.append(f"{runs}: {len(nodes)} vertices, {shared} seen by several runs")
    way_m = sum(edge["length"] for edge in merged["edges"])
    lines.append(f"{len(merged['edges'])} corridors, {way_m:.0f} m")
    for pair in merged["merges"]:
        lines.append(
            f"{pair['a']}, {pair['b']}: {pair['verdict']}, {pair['evidence_bits']:.0f} bits"
        )
    return "\n".join(lines)


def shown_by(picture: Path) -> str:
    """The facts that a picture was made of."""
    from PIL import Image

    with Image.open(picture) as image:
        return str(image.info.get(SHOWS, ""))


def merged_samples(workspace: Path) -> None:
    """Ingest and merge the sample logs, as a user would."""
    for call in (["ingest", str(ROOT / "sample_logs")], ["merge", "--all"]):
        command = [sys.executable, "-m", "topobatch.cli", *call, "--quiet"]
        subprocess.run([*command, "--workspace", str(workspace)], check=True)


def screenshot(recording: Path, out: Path) -> None:
    """Open a recording in a viewer without a window and save what it paints."""
    import rerun_cli
    from rerun.experimental import ViewerClient

    # The viewer that came with the library, whatever else there is.
    own = str(Path(rerun_cli.__file__).parent)
    os.environ["PATH"] = os.pathsep.join([own, os.environ.get("PATH", "")])
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.mkdtemp())
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True) as viewer:
        viewer.open([str(recording.resolve())])
        begin = time.monotonic()
        while viewer.get_state().loading:
            if time.monotonic() - begin > LOADING_S:
                sys.exit(f"{recording}: the viewer did not load it in {LOADING_S:.0f} s")
            time.sleep(0.1)
        for panel in PANELS:
            viewer.run_command(panel)
        time.sleep(PAINTING_S)  # views fetch and paint on their own; the viewer greets and is quiet
        viewer.save_screenshot(str(out))


def save(picture: Path, screen: Path, text: str) -> None:
    """Keep a screenshot small, and with what it shows as text."""
    from PIL import Image, PngImagePlugin

    note = PngImagePlugin.PngInfo()
    note.add_itxt(SHOWS, text)
    with Image.open(screen) as image:
        top, bottom = round(TOP * image.height), round(BOTTOM * image.height)
        views = image.convert("RGB").crop((0, top, image.width, bottom))
        height = round(views.height * WIDTH / views.width)
        small = views.resize((WIDTH, height), Image.Resampling.LANCZOS)
        few = small.quantize(COLOURS, kmeans=3)
        few.save(picture, optimize=True, pnginfo=note)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=PICTURE)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        workspace, screen = Path(folder) / "ws", Path(folder) / "screen.png"
        merged_samples(workspace)
        screenshot(workspace / "merged.rrd", screen)
        save(args.out, screen, facts(json.loads((workspace / "merged.json").read_bytes())))
    print(f"{args.out}:\n{shown_by(args.out)}")


if __name__ == "__main__":
    main()
