"""Processes that are killed, that meet in one workspace, or whose disk is full: nothing is lost."""

from __future__ import annotations

import random
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from judge import halves, left_overs, parsed
from sandbox import Budget, Child, command, run
from trials import Ground, Trial, Tried, copied, ingest, judged, merge

ATTEMPTS = 1.2
"""Moments of a kill: up to so many times the time that the call takes when it is left alone."""


def _finished(ground: Ground, workspace: Path) -> str:
    """ "" if a workspace holds exactly what the sound logs give, whole."""
    maps = {p.stem: p.read_bytes() for p in (workspace / "maps").glob("*.json")}
    if maps != ground.maps:
        return f"the maps differ from those of an undisturbed call: {sorted(maps)}"
    return halves(workspace) or left_overs(workspace) or parsed(workspace)


def killed_ingest(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """ingest is killed at any moment; the next one finishes."""
    workspace = folder / "ws"
    if rng.random() < 0.3:  # over an older state
        workspace = copied(ground, folder)
        shutil.rmtree(workspace / "cache")
    call = ingest(workspace, ground.logs)
    after = rng.random() * ATTEMPTS * _time_of(ground, "ingest")
    child = Child(call, folder)
    time.sleep(after)
    child.kill()
    child.finish()
    outcome = run(call, folder)
    return judged([outcome], f"after {after:.3f} s", _finished(ground, workspace))


def killed_merge(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """merge is killed at any moment: the old document or the new one stays; the next finishes."""
    workspace = copied(ground, folder)
    old = b'{"old": true}\n'
    (workspace / "merged.json").write_bytes(old)
    after = rng.random() * ATTEMPTS * _time_of(ground, "merge")
    child = Child(merge(workspace), folder)
    time.sleep(after)
    child.kill()
    child.finish()
    torn = (workspace / "merged.json").read_bytes() not in (old, ground.merged)
    outcome = run(merge(workspace), folder)
    same = (workspace / "merged.json").read_bytes() == ground.merged
    return judged(
        [outcome],
        f"after {after:.3f} s",
        "merged.json was torn" if torn else "",
        "" if same else "merged.json differs from that of an undisturbed call",
        _finished(ground, workspace),
    )


_times: dict[str, float] = {}


def _time_of(ground: Ground, what: str) -> float:
    """How long a call takes when it is left alone [s], measured once."""
    if what not in _times:
        folder = ground.root / f"time-{what}"
        folder.mkdir()
        call: Callable[[], None] = merge(copied(ground, folder))
        if what == "ingest":
            call = ingest(folder / "new", ground.logs)
        _times[what] = run(call, folder).wall_s
    return _times[what]


def race(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """Two or three calls at work on one workspace at a time."""
    workspace = copied(ground, folder) if rng.random() < 0.5 else folder / "ws"
    forced = ["--force"] if rng.random() < 0.5 else []
    first = ingest(workspace, ground.logs, *forced)
    others = [ingest(workspace, ground.logs / "a.mcap", *forced), ingest(workspace, ground.logs)]
    if workspace.exists():
        others += [merge(workspace), command(["explain", "a", "b", "-w", workspace])]
        others += [command(["lock", "a", "b", "--clear", "-w", workspace])]
    calls = [first, *rng.sample(others, rng.randrange(1, 3))]
    children = []
    for number, call in enumerate(calls):
        children.append(Child(call, folder / f"call{number}"))
        time.sleep(rng.random() * 0.2)
    outcomes = [child.finish() for child in children]
    failed = [outcome.err for outcome in outcomes if outcome.code != 0]
    problem = f"a call failed: {failed[0][:300]}" if failed else _finished(ground, workspace)
    return judged(outcomes, f"{len(calls)} calls", problem)


def full_disk(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """No file can grow beyond some size; with room again, the next call finishes."""
    workspace = copied(ground, folder)
    what = rng.choice(("ingest", "ingest anew", "merge"))
    if what == "ingest":
        shutil.rmtree(workspace / "maps")
    call = merge(workspace) if what == "merge" else ingest(workspace, ground.logs, "--force")
    largest = round(2 ** rng.uniform(10, 19))
    full = run(call, folder, Budget(), largest)
    half = halves(workspace) or left_overs(workspace) or parsed(workspace)
    after = run(merge(workspace) if what == "merge" else ingest(workspace, ground.logs), folder)
    done = "" if after.code == 0 else f"the next call failed: {after.err[:300]}"
    return judged(
        [full, after], f"{what}, {largest} bytes", half, done, _finished(ground, workspace)
    )


TRIALS: dict[str, Trial] = {
    "kill -9 of ingest": killed_ingest,
    "kill -9 of merge": killed_merge,
    "calls at one time": race,
    "full disks": full_disk,
}
"""By class."""
