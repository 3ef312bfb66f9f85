"""How long `topobatch --help` takes, beside `import rerun`, in one run.

python benchmarks/startup.py [--rounds N]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys


def cpu_s(command: list[str]) -> float:
    """CPU time of a child process, user and system."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    calls = {
        "python -c pass": [sys.executable, "-c", "pass"],
        "topobatch --help": [sys.executable, "-m", "topobatch.cli", "--help"],
        "topobatch ingest --help": [sys.executable, "-m", "topobatch.cli", "ingest", "--help"],
        "import rerun": [sys.executable, "-c", "import rerun"],
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):  # in turn, so that other work on the machine troubles all alike
        for name, command in calls.items():
            times[name].append(cpu_s(command))
    best = {name: min(found) for name, found in times.items()}
    print(f"best of {rounds}, CPU s   share of import rerun")
    for name, seconds in best.items():
        print(f"{name:24} {seconds:6.3f}   {seconds / best['import rerun']:.2f}")


if __name__ == "__main__":
    main()
