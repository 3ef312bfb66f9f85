"""Threads, memory and open files of one process that ingests many small logs, over time.

python benchmarks/soak.py [--logs 1000]

What stays behind a log shows as a column that grows; flat is good.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.writing import write_run

ROWS = 10
KINDS = ("mcap", "bag", "db3")


def make_logs(folder: Path, logs: int) -> None:
    """Copies of one small run in three containers, each with a name of its own."""
    settings = ScenarioSettings(runs=1, junctions_per_run=6, drift="low", odometry_hz=5, seed=5)
    simulated = simulate_scenario(settings).simulated[0]
    made = [write_run(folder.parent / kind, simulated, kind) for kind in KINDS]
    folder.mkdir()
    for number in range(logs):
        source = made[number % len(made)]
        name = f"run{number:05d}"
        if source.is_dir():
            shutil.copytree(source, folder / name)
        else:
            shutil.copy(source, folder / f"{name}{source.suffix}")


def held(process: int) -> tuple[int, float, int]:
    """Threads, resident memory [MB] and open files of a process."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    status = dict(line.split(":", 1) for line in lines)
    files = len(list(Path(f"/proc/{process}/fd").iterdir()))
    # A process that has just ended holds no memory any more.
    return int(status["Threads"]), int(status.get("VmRSS", "0 kB").split()[0]) / 1000, files


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--logs", type=int, default=1000)
    logs = parser.parse_args().logs
    if not Path("/proc/self/status").exists():
        print("soak.py: needs /proc to look into a process; nothing was measured")
        return 0
    with tempfile.TemporaryDirectory() as temporary:
        folder, workspace = Path(temporary) / "logs", Path(temporary) / "workspace"
        make_logs(folder, logs)
        command = [sys.executable, "-m", "topobatch.cli", "ingest", folder, "-w", workspace]
        process = subprocess.Popen([*command, "-j", "1", "-q"])
        print("  logs  threads  resident MB  open files  seconds", flush=True)
        started, shown = time.monotonic(), 0
        while process.poll() is None:
            time.sleep(0.05)
            # The cache record is a run's last file.
            done = len(list((workspace / "cache" / "ingest").glob("[!.]*.json")))
            if done - shown >= logs / ROWS and process.poll() is None:
                shown = done
                threads, resident, files = held(process.pid)
                seconds = time.monotonic() - started
                print(
                    f"{done:6} {threads:8} {resident:12.1f} {files:11} {seconds:8.1f}", flush=True
                )
        return process.returncode


if __name__ == "__main__":
    sys.exit(main())
