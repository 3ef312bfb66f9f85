"""Which of the numbers chosen for the speed of reading matter, and by how much.

    python benchmarks/reading_numbers.py [--only NAME] [--repeats 7] [--out DIR]

Every number is made an eighth of what it is, and eight times as large; the table shows the CPU time
of reading one log with it, as a share of that with the number as it is. The reads take turns, and
each share is the median of its repeats; what a share of 1 is uncertain by is told by the last row,
in which nothing is changed. What is read is the same with all of them.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ingest import Size, imports_of, measure_topobatch, write_bag, write_db3, write_mcap

NUMBERS = {
    "TOGETHER_BYTES": "chunks",
    "INPUT_BYTES": "inflate",
    "PIECE_BYTES": "inflate",
    "DENSE": "intake",
    "PENDING_BYTES": "intake",
    "ROWS": "sqlite",
    "REACH": "walk",
    "SLAB_BYTES": "source",
}
"""Numbers that change nothing but the time, by the module that chooses them."""

SHARES = (0.125, 8.0)


def logs(folder: Path) -> dict[str, Path]:
    """One log of every container, and two in chunks of one message."""
    size, camera = Size(30_000, 600, 32), Size(3_000, 60, 64)
    single = Size(4_000, 80, 0)
    found = {
        "zstd": folder / "zstd.mcap",
        "lz4": folder / "lz4.mcap",
        "none": folder / "none.mcap",
        "bag": folder / "plain.bag",
        "camera": folder / "camera.bag",
        "db3": folder / "db3",
        "mcap of 1": folder / "single.mcap",
        "bag of 1": folder / "single.bag",
    }
    if not all(path.exists() for path in found.values()):
        for name in ("zstd", "lz4", "none"):
            write_mcap(found[name], size, name.upper())
        write_bag(found["bag"], size)
        write_bag(found["camera"], camera)
        write_db3(found["db3"], size)
        write_mcap(found["mcap of 1"], single, "NONE", 1)
        write_bag(found["bag of 1"], single, 1)
    return found


@contextmanager
def changed(number: str, share: float) -> Iterator[None]:
    """While the body runs, a number is another one, wherever it was imported."""
    package = importlib.import_module("topobatch.ingest.logs")
    names = (f"{package.__name__}.{found.name}" for found in pkgutil.iter_modules(package.__path__))
    modules = [importlib.import_module(name) for name in names]
    home = importlib.import_module(f"{package.__name__}.{NUMBERS[number]}")
    holder, _, name = number.rpartition(".")
    owner: Any = getattr(home, holder) if holder else home
    value = getattr(owner, name)
    places = [owner] if holder else [m for m in modules if getattr(m, name, None) == value]
    for place in places:
        setattr(place, name, max(1, round(value * share)))
    try:
        yield
    finally:
        for place in places:
            setattr(place, name, value)


def seconds(path: Path) -> float:
    begin = time.process_time()
    measure_topobatch(path)
    return time.process_time() - begin


def shares(path: Path, number: str | None, repeats: int) -> tuple[float, float]:
    """CPU time with the smaller and the larger number, by that with the number as it is."""
    found: list[tuple[float, ...]] = []
    for _ in range(repeats):
        usual, times = seconds(path), []
        for share in SHARES:
            if number is None:
                times.append(seconds(path))
                continue
            with changed(number, share):
                times.append(seconds(path))
        found.append(tuple(t / (0.5 * (usual + seconds(path))) for t in times))
    less, more = (statistics.median(column) for column in zip(*found, strict=True))
    return less, more


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="", help="numbers whose names hold this")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--out", type=Path, help="folder for the logs, which are used again")
    arguments = parser.parse_args()
    imports_of("topobatch")
    folder = arguments.out or Path(tempfile.mkdtemp(prefix="topobatch-benchmark-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        paths = logs(folder)
        print(f"{'number, / 8 and x 8':24s}" + "".join(f"{name:>12s}" for name in paths))
        for path in paths.values():
            measure_topobatch(path)
        for number in [*(name for name in NUMBERS if arguments.only in name), None]:
            cells = [shares(path, number, arguments.repeats) for path in paths.values()]
            row = "".join(f"{less:7.2f}{more:5.2f}" for less, more in cells)
            print(f"{number or '(none)':24s}{row}", flush=True)
    finally:
        if arguments.out is None:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
