"""The attack: hostile logs, documents, folders, kills and races, thousands of them.

    python tests/hostile/attack.py [--tries 10000] [--seed 0] [--only TEXT,...] [--jobs 2]

Every try is the real command in a process of its own, forked from one that has imported most of
what it needs, with CPU time, memory and wall time limited and measured from outside. A try fails
on: an exit code other than 0, 1 and 2, a traceback, an internal error; a budget exceeded; more than
1 % of the intact messages unused, no word of lost ones; another log of the same
call lost; a file outside of the workspace touched; half a run or half a file left; a control
character on the terminal. The same seed gives the same tries. Exits with 1 if any failed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SHARES = {
    "floods of files": 0.01,
    "broken entries among sound logs": 0.05,
    "names that steer terminals": 0.05,
    "tables of places": 0.02,
    "hostile documents": 0.15,
    "no file where one should be": 0.1,
    "kill -9 of ingest": 0.01,
    "kill -9 of merge": 0.01,
    "calls at one time": 0.01,
    "full disks": 0.02,
}
"""Of all tries."""

BOMBS = 0.12
"""Of all tries, for logs that inflate: they take longest, and their kinds have few variants. Other
hostile logs share the rest; each class alike."""


def trials() -> dict[str, Any]:
    """All classes by name."""
    import trials_documents
    import trials_folders
    import trials_logs
    import trials_stops

    return {
        **trials_logs.TRIALS,
        **trials_folders.TRIALS,
        **trials_documents.TRIALS,
        **trials_stops.TRIALS,
    }


def numbers(tries: int, only: str) -> dict[str, int]:
    """How many tries each class gets, at least one."""
    import logs_bombs

    chosen = [name for name in trials() if any(text in name for text in only.split(","))]
    if not chosen:
        raise SystemExit(f"no class is called like {only!r}; there are: {', '.join(trials())}")
    bombs = [name for name in chosen if name in logs_bombs.CASES]
    logs = [name for name in chosen if name not in SHARES and name not in bombs]
    rest = 1 - BOMBS - sum(SHARES.values())
    share = {name: SHARES[name] for name in chosen if name in SHARES}
    share |= {name: BOMBS / len(bombs) for name in bombs}
    share |= {name: rest / len(logs) for name in logs}
    total = sum(share.values())
    return {name: max(1, round(tries * share[name] / total)) for name in chosen}


def work(tries: int, seed: int, only: str, part: tuple[int, int], keep: Path | None) -> None:
    """Every `part[1]`th try, a JSON line for each, on the standard output."""
    import sandbox
    from trials import Tried, prepare

    sandbox.load()
    made = trials()
    with tempfile.TemporaryDirectory(prefix="attack-") as temporary:
        root = Path(temporary)
        ground = prepare(root / "ground")
        plan = [(name, k) for name, count in numbers(tries, only).items() for k in range(count)]
        random.Random(seed).shuffle(plan)  # that classes of long tries do not stand at the end
        for name, number in plan[part[0] :: part[1]]:
            folder = root / "try"
            folder.mkdir()
            rng = random.Random(f"{seed} {name} {number}")
            started = time.monotonic()
            try:
                found = made[name](ground, rng, folder)
            except Exception:  # a try that breaks is none, and must not cost the others
                found = Tried(f"the try itself broke: {traceback.format_exc(limit=-2)}", "")
            line = {"class": name, "number": number, **found._asdict()}
            print(json.dumps(line | {"wall_s": time.monotonic() - started}), flush=True)
            if found.problem and keep is not None:
                kept = keep / f"{name}-{number}"
                shutil.rmtree(kept, ignore_errors=True)
                subprocess.run(["cp", "-a", str(folder), str(kept)], check=False)
            subprocess.run(["rm", "-rf", str(folder)], check=True)


def results(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """What all tries found, as they come."""
    program = [sys.executable, __file__, "--tries", str(arguments.tries)]
    program += ["--seed", str(arguments.seed), "--only", arguments.only]
    if arguments.keep is not None:
        arguments.keep.mkdir(parents=True, exist_ok=True)
        program += ["--keep", str(arguments.keep)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    environment.pop("TOPOBATCH_DEBUG", None)
    workers = [
        subprocess.Popen(
            [*program, "--part", f"{k}/{arguments.jobs}"],
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for k in range(arguments.jobs)
    ]
    import selectors

    with selectors.DefaultSelector() as selector:
        for worker in workers:
            assert worker.stdout is not None
            selector.register(worker.stdout, selectors.EVENT_READ)
        while selector.get_map():
            for key, _ in selector.select():
                line = key.fileobj.readline()  # type: ignore[union-attr]
                if line:
                    yield json.loads(line)
                else:
                    selector.unregister(key.fileobj)
    if any(worker.wait() for worker in workers):
        raise SystemExit("the attack itself broke off")


def table(found: list[dict[str, Any]]) -> list[str]:
    """The record, in Markdown."""
    by_class: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for result in found:
        by_class[result["class"]].append(result)
    lines = ["| class | tries | failures | most CPU s | most memory MB |", "| --- " * 5 + "|"]
    for name in [name for name in trials() if name in by_class]:
        tried = by_class[name]
        lines.append(
            f"| {name} | {len(tried):,} | {sum(bool(t['problem']) for t in tried)} "
            f"| {max(t['cpu_s'] for t in tried):.1f} | {max(t['memory_mb'] for t in tried):.0f} |"
        )
    failed = sum(bool(result["problem"]) for result in found)
    return [*lines, f"| **all** | **{len(found):,}** | **{failed}** | | |"]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tries", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="classes whose names hold this, or this,that")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--keep", type=Path, help="folder for what was tried where it failed")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if not sys.platform.startswith("linux"):
        print("the attack watches processes by /proc, which is there on Linux alone")
        return 0
    if arguments.part:
        k, n = map(int, arguments.part.split("/"))
        work(arguments.tries, arguments.seed, arguments.only, (k, n), arguments.keep)
        return 0
    started, found = time.monotonic(), []
    try:
        for result in results(arguments):
            found.append(result)
            if result["problem"]:
                print(f"FAILED {result['class']} {result['number']} ({result['note']}): ", end="")
                print(ascii(result["problem"]), flush=True)
            if len(found) % 100 == 0:
                print(f"{len(found)} tries, {time.monotonic() - started:.0f} s", flush=True)
    except KeyboardInterrupt:
        print("interrupted; so far:")
    print("\n".join(["", *table(found), ""]))
    print(
        f"seed {arguments.seed}, {time.monotonic() - started:.0f} s on {arguments.jobs} processes"
    )
    return 1 if any(result["problem"] for result in found) else 0


if __name__ == "__main__":
    sys.exit(main())
