"""Fuzzing of log reading: mutated sample logs must be read, or refused in one line.

    python tests/ingest/fuzz_logs.py --inputs 100000 [--seed 0] [--only bag]

Every input is a sample log with a few random mutations. A failure is: an exception outside the
library's own family, a message of several lines, a read that takes longer than SLOW_S of CPU time,
more memory than MEMORY_MB, or a run that lacks messages without saying so.
"""

from __future__ import annotations

import argparse
import importlib.util
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

from topobatch.ingest.reading import ReadSettings, find_logs, inspect_log, read_run
from topobatch.topology.errors import TopobatchError

SLOW_S = 5.0
HANG_S = 30.0
MEMORY_MB = 1500
MESSAGES = 66
EXTREMES = (0, 1, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)


def writers() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "writers", Path(__file__).parent / "log_writers.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["writers"] = module
    spec.loader.exec_module(module)
    return module


def corpus(folder: Path, only: str = "") -> dict[str, Path]:
    """The sample logs: one file each, by name."""
    from mcap.writer import IndexType

    logs = writers()
    messages = logs.drive(60, 10)
    bare = {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False}
    made: dict[str, Callable[[Path], Path]] = {
        "mcap-zstd": lambda p: logs.mcap(p, messages),
        "mcap-lz4": lambda p: logs.mcap(p, messages, compression="LZ4"),
        "mcap-none": lambda p: logs.mcap(p, messages, compression="NONE", enable_crcs=False),
        "mcap-unchunked": lambda p: logs.mcap(p, messages, use_chunking=False),
        "mcap-bare": lambda p: logs.mcap(p, messages, repeat_channels=False, **bare),
        "mcap-ros1": lambda p: logs.mcap(p, messages, "ros1", compression="NONE"),
        "mcap-protobuf": lambda p: logs.mcap(
            p, messages, "protobuf", compression="NONE", enable_crcs=False
        ),
        "mcap-json": lambda p: logs.mcap(
            p, messages, "json", compression="NONE", enable_crcs=False
        ),
        "bag-none": lambda p: logs.bag(p, messages),
        "bag-lz4": lambda p: logs.bag(p, messages, "lz4"),
        "bag-bz2": lambda p: logs.bag(p, messages, "bz2"),
        "bag-active": lambda p: active(logs.bag(p, messages)),
        "db3": lambda p: only_file(logs.ros2_folder(p, messages)),
        "db3-zstd": lambda p: only_file(logs.ros2_folder(p, messages, "SQLITE3", "MESSAGE")),
    }
    folder.mkdir(parents=True, exist_ok=True)
    return {name: write(folder / name) for name, write in made.items() if only in name}


def active(path: Path) -> Path:
    """A bag whose recorder died before it wrote the index."""
    raw = path.read_bytes()
    index = struct.unpack_from("<Q", raw, raw.index(b"index_pos=") + 10)[0]
    path.write_bytes(raw[:index].replace(struct.pack("<Q", index), bytes(8), 1))
    return path


def only_file(folder: Path) -> Path:
    return next(file for file in folder.iterdir() if file.suffix != ".yaml")


def mutated(raw: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one to four mutations."""
    out = bytearray(raw)
    for _ in range(int(rng.integers(1, 5))):
        size = len(out)
        if size < 16:
            break
        at = int(rng.integers(0, size - 8))
        length = int(min(size - at, 2 ** rng.integers(0, 11)))
        match int(rng.integers(0, 9)):
            case 0:
                out[at] ^= 1 << int(rng.integers(0, 8))
            case 1:
                out[at] = int(rng.integers(0, 256))
            case 2:
                out[at : at + 4] = struct.pack("<I", int(rng.choice(EXTREMES[:6])))
            case 3:
                out[at : at + 8] = struct.pack("<Q", EXTREMES[int(rng.integers(0, 9))])
            case 4:
                del out[at:]
            case 5:
                del out[at : at + length]
            case 6:
                out[at:at] = out[at : at + length]
            case 7:
                out[at : at + length] = bytes(length)
            case 8:
                other = int(rng.integers(0, size - length + 1))
                out[at : at + length] = out[other : other + length]
    return bytes(out)


SETTINGS = (
    *[ReadSettings()] * 7,
    *[ReadSettings(time="log")] * 2,
    ReadSettings(junction_topic="/junctions", junction_fields="center=poses[],branches=poses[]"),
)


def _hangs(*_: object) -> None:
    raise TimeoutError(f"no end after {HANG_S} s")


def problem_of(path: Path, settings: ReadSettings) -> str | None:
    """What is wrong with the way a file is read, None if nothing is."""
    started = time.process_time()
    found = None
    signal.signal(signal.SIGVTALRM, _hangs)
    signal.setitimer(signal.ITIMER_VIRTUAL, HANG_S)
    try:
        run = read_run(path, settings)
        if len(run.odometry) + len(run.detections) < MESSAGES and not run.warnings:
            found = f"silent loss: {len(run.odometry)} + {len(run.detections)}"
    except TopobatchError as error:
        if "\n" in str(error) or str(path) not in str(error):
            found = f"message: {error}"
    # Anything else that leaves the library is exactly what is looked for.
    except Exception as error:
        found = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    if time.process_time() - started > SLOW_S:
        found = f"slow: {time.process_time() - started:.1f} s"
    return found


def inspection_problem(path: Path) -> str | None:
    try:
        inspect_log(path)
        find_logs([path.parent])
    except TopobatchError as error:
        return f"message: {error}" if "\n" in str(error) else None
    except Exception as error:
        return f"inspect: {type(error).__name__}: {error}"
    return None


def failures(
    samples: dict[str, Path], inputs: int, seed: int, folder: Path, first: int = 0
) -> Iterator[tuple[str, int, str, bytes]]:
    """Name, number, problem and bytes of every input that fails."""
    contents = {name: path.read_bytes() for name, path in samples.items()}
    names = sorted(contents)
    for number in range(first, first + inputs):
        rng = np.random.default_rng([seed, number])
        name = names[number % len(names)]
        raw = mutated(contents[name], rng)
        path = folder / f"input{samples[name].suffix}"
        path.write_bytes(raw)
        found = problem_of(path, SETTINGS[number // len(names) % 10])
        if found is None and number % 10 == 0:
            found = inspection_problem(path)
        if found is not None:
            yield name, number, found, raw


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--keep", type=Path, help="folder for the inputs that fail")
    args = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_MB << 20, MEMORY_MB << 20))
    kinds: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        samples = corpus(Path(name) / "corpus", args.only)
        work = Path(name) / "work"
        work.mkdir()
        for sample, number, problem, raw in failures(
            samples, args.inputs, args.seed, work, args.first
        ):
            kinds[sample] += 1
            sys.stdout.write(f"{sample} input {number}: {problem}\n")
            sys.stdout.flush()
            if args.keep:
                args.keep.mkdir(parents=True, exist_ok=True)
                (args.keep / f"{sample}-{number}").write_bytes(raw)
        shutil.rmtree(work)
    sys.stdout.write(
        f"{args.inputs} inputs of {len(samples)} samples, {kinds.total()} failures {dict(kinds)}\n"
    )
    return 1 if kinds else 0


if __name__ == "__main__":
    sys.exit(main())
