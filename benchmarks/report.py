"""How large the report of a workspace is, how long it takes to write, and when its first map shows.

python benchmarks/report.py WORKSPACE [--rounds N]

The browser is Debian's chromium-headless-shell, or another Chromium that is found.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


def written(workspace: Path, page: Path) -> float:
    """CPU time of writing the page."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    call = [sys.executable, "-m", "topobatch.cli", "report", str(page), "-w", str(workspace)]
    subprocess.run(call, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def shown(page: Path, rounds: int) -> tuple[list[float], list[float]]:
    """Seconds from the request of the page to its first map, and to all of it."""
    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser_path is None:
        raise SystemExit("there is no Chromium here")
    first, every = [], []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        for _ in range(rounds):
            tab = browser.new_page(viewport={"width": 1280, "height": 900})
            tab.goto(page.as_uri())
            tab.wait_for_selector("html[data-drawn=all]", state="attached")
            marks = tab.evaluate(
                "performance.getEntriesByType('mark').map(m => [m.name, m.startTime / 1e3])"
            )
            first.append(dict(marks)["first map"])
            every.append(dict(marks)["all maps"])
            tab.close()
        browser.close()
    return first, every


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        cpu_s = written(args.workspace, page)
        first, every = shown(page, args.rounds)
        print(
            f"{page.stat().st_size / 1e6:.1f} MB, written in {cpu_s:.1f} s (CPU); first map after "
            f"{statistics.median(first):.2f} s, all after {statistics.median(every):.2f} s "
            f"(medians of {args.rounds})"
        )


if __name__ == "__main__":
    main()
