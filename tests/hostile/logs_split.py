"""Folders of parts: missing, repeated, overlapping, of other runs, named by paths, behind links."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

from case import Case, Generator, writers

PARTS = 4
ODOMETRY = 400


def _parts(rng: random.Random, folder: Path) -> tuple[Path, list[int]]:
    """A bag folder of four parts with its metadata, and how many messages each has."""
    logs, place = writers(), folder / "run"
    place.mkdir()
    messages = logs.drive(ODOMETRY)
    each = -(-len(messages) // PARTS)
    lists = [messages[k * each : (k + 1) * each] for k in range(PARTS)]
    suffix = rng.choice((".mcap", ".db3"))
    for number, part in enumerate(lists):
        path = place / f"run_{number}{suffix}"
        if suffix == ".mcap":
            logs.mcap(path, part)
        else:
            made = logs.ros2_folder(folder / f"made{number}", part)
            shutil.move(next(made.glob("*.db3")), path)
            shutil.rmtree(made)
    _metadata(place, [p.name for p in sorted(place.iterdir())], len(messages))
    return place, [len(part) for part in lists]


def _metadata(place: Path, names: list[str], count: int) -> None:
    lines = ["rosbag2_bagfile_information:", "  version: 5", f"  message_count: {count}"]
    lines += ["  relative_file_paths:", *(f"    - {name}" for name in names)]
    (place / "metadata.yaml").write_text("\n".join(lines) + "\n")


def _logs(place: Path) -> list[Path]:
    return sorted(p for p in place.iterdir() if p.suffix != ".yaml")


def _missing(rng: random.Random, place: Path, counts: list[int]) -> tuple[int | None, int | None]:
    gone = rng.sample(range(PARTS), rng.randint(1, PARTS - 1))
    for number in gone:
        path = _logs_by_number(place)[number]
        if rng.random() < 0.5:
            path.unlink()
        else:
            path.write_bytes(b"")
    lost = sum(counts[k] for k in gone)
    return sum(counts) - lost, None


def _logs_by_number(place: Path) -> dict[int, Path]:
    return {int(path.stem.rpartition("_")[2]): path for path in _logs(place)}


def _named(rng: random.Random, place: Path, counts: list[int]) -> tuple[int | None, int | None]:
    """Metadata that names files elsewhere, or what is no name."""
    names = [p.name for p in _logs(place)]
    odd = (
        "../../secret.mcap",
        "/etc/passwd",
        str(place.parent / "secret.mcap"),
        "../" * 2000 + "dev/zero",
        ".",
        "..",
        "C:\\\\x.mcap",
        "\x1b[31m.mcap",
        "x" * 100_000,
        '"\\ud800"',
        '"a\\u0000b"',
    )
    writers().mcap(place.parent / "secret.mcap", writers().drive(100))
    _metadata(place, rng.sample(odd, rng.randint(1, 4)) + names, sum(counts))
    return sum(counts), 0


def _linked(rng: random.Random, place: Path, counts: list[int]) -> tuple[int | None, int | None]:
    """Parts that are links to themselves, in circles, to devices, to folders, to nothing."""
    for k in range(rng.randint(1, 4)):
        path = place / f"run_{PARTS + k}.mcap"
        goal = rng.choice((path.name, "gone", ".", "..", "/dev/zero", "/proc/self/mem", "/proc"))
        path.symlink_to(goal)
    if rng.random() < 0.5:
        os.mkfifo(place / "run_9.db3")
    (place / "below").symlink_to("..")
    return sum(counts), None


def _split(
    change: Callable[[random.Random, Path, list[int]], tuple[int | None, int | None]], note: str
) -> Generator:
    def write(rng: random.Random, folder: Path) -> Case:
        place, counts = _parts(rng, folder)
        intact, lost = change(rng, place, counts)
        if rng.random() < 0.2:
            # The parts may be runs of their own now.
            (place / "metadata.yaml").unlink()
            intact = lost = None
        return Case(place, intact, lost, note)

    return write


CASES: dict[str, Generator] = {
    "split-missing": _split(_missing, "parts are missing or empty"),
    "split-named": _split(_named, "metadata that names files elsewhere"),
    "split-linked": _split(_linked, "parts that are links"),
}
