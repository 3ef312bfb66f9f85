"""Folders full of anything, names that steer terminals: one bad entry costs no other."""

from __future__ import annotations

import os
import random
import shutil
from pathlib import Path

from case import writers
from judge import halves
from sandbox import Budget, command, run
from trials import Ground, Trial, Tried, Victim, ingest, judged

SUFFIXES = (".mcap", ".bag", ".db3", ".bag.active", ".mcap.zstd", ".db3.zst", ".yaml", ".json", "")
HEADS = (b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"\x28\xb5\x2f\xfd", b"", b"\0")
CONTROL = "\x1b]0;evil\x07\x1b[31mred\r\n\x9b\u202e\x7f"


def _kept(ground: Ground, workspace: Path, names: str) -> str:
    """What of the sound logs `names` was lost."""
    for name in names:
        path = workspace / "maps" / f"{name}.json"
        if not path.exists() or path.read_bytes() != ground.maps[name]:
            return f"the sound log {name} was lost"
    return ""


def flood(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """Thousands of files that are no logs, and two that are."""
    place = folder / "logs"
    place.mkdir()
    files = rng.choice((300, 1000))
    for number in range(files):
        head = rng.choice(HEADS)
        body = rng.randbytes(rng.choice((0, 8, 100)))
        (place / f"f{number}{rng.choice(SUFFIXES)}").write_bytes(head + body)
    for name in ("a.mcap", "b.bag"):
        shutil.copy(ground.logs / name, place)
    # Every one of them gets its line; 5 ms each.
    budget = Budget(cpu_s=10 + 0.005 * files, memory_mb=300)
    outcome = run(ingest(folder / "ws", place), folder, budget)
    return judged([outcome], f"{files} files", _kept(ground, folder / "ws", "ab"))


def broken(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """Parts, links, FIFOs, empty and unreadable files among sound logs, in folders or named."""
    place = folder / "logs"
    shutil.copytree(ground.logs, place)
    victim = Victim(folder / "victim")
    named: list[Path] = []
    raw = (ground.logs / "a.mcap").read_bytes()
    for number in range(rng.randrange(1, 6)):
        home = rng.choice((place, place / "more", place / "c", folder / "named"))
        home.mkdir(exist_ok=True)
        suffix = rng.choice(SUFFIXES[:4])
        path = home / rng.choice((f"bad{number}{suffix}", f"x_{number}.mcap", f"a_{number}.mcap"))
        if os.path.lexists(path):
            continue
        _broken(path, raw, rng)
        if home.name == "named":
            named.append(path)
    for name in ("x" * 300, "y" * 5000, "gone.bag"):
        if rng.random() < 0.2:
            named.append(folder / name)
    outcome = run(ingest(folder / "ws", place, *named), folder, Budget(cpu_s=20))
    # What lies in c/ belongs to that run.
    kept = _kept(ground, folder / "ws", "ab")
    return judged([outcome], f"{len(named)} named", kept, victim.touched(), halves(folder / "ws"))


def _broken(path: Path, raw: bytes, rng: random.Random) -> None:
    match rng.randrange(7):
        case 0:
            path.write_bytes(raw[:8])
        case 1:
            path.write_bytes(b"")
        case 2:
            path.symlink_to("gone")
        case 3:
            path.symlink_to(path.name)
        case 4:
            os.mkfifo(path)
        case 5:
            path.write_bytes(raw[: rng.randrange(len(raw))])
        case _:
            path.mkdir()


def names(ground: Ground, rng: random.Random, folder: Path) -> Tried:
    """Control characters in the names of files, topics, types and frames."""
    place = folder / "logs"
    place.mkdir()
    evil = "".join(rng.sample(CONTROL, len(CONTROL)))
    messages = writers().drive(60, 10)
    renamed = [_renamed(message, evil, rng.random()) for message in messages]
    log = place / ("log.mcap" if rng.random() < 0.5 else f"l{evil}.mcap".replace("/", ""))
    writers().mcap(log, renamed)
    workspace = folder / "ws"
    calls = [
        command(["info", log]),
        ingest(workspace, log, folder / f"gone{evil}"),
        command(["ingest", log, "-w", workspace, "-j", "1", "--name", "plain"]),
        command(["ingest", log, "-w", workspace, "--odometry-topic", evil]),
        command(["merge", "--all", "-w", workspace]),
        command(["lock", evil, "plain", "--never", "-w", workspace]),
        command(["explain", "plain", f"-{evil}", "-w", workspace]),
    ]
    outcomes = [run(call, folder) for call in rng.sample(calls, 3)]
    for outcome in outcomes:
        if outcome.code == 2 and outcome.err.startswith("Usage: "):
            continue
    return judged(outcomes, repr(log.name))


def _renamed(message: object, evil: str, chance: float) -> object:
    from dataclasses import replace

    odd = replace(message, frame=f"{message.frame}{evil}", child=f"{message.child}{evil}")  # type: ignore
    return replace(odd, topic=f"{message.topic}{evil}") if chance < 0.3 else odd  # type: ignore


TRIALS: dict[str, Trial] = {
    "floods of files": flood,
    "broken entries among sound logs": broken,
    "names that steer terminals": names,
}
"""By class."""
