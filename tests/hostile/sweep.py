"""One wrong bit, tens of thousands of times: what is missing of a log is told.

    python tests/hostile/sweep.py [--tries 1000] [--seed 0] [--only TEXT]

Unlike the attack this reads small logs, in this process, without making maps: a hundred times as
many tries for the time, and the count of every message is known. Each kind of log is tried with two
channels and with four, whose numbers are a bit apart. Exits with 1 if any try failed.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import logs_flips
from case import read_of, writers
from logs_flips import HEAD, Sound

ODOMETRY = 60


def two_channels() -> list[Any]:
    """Odometry and detections."""
    return list(writers().drive(ODOMETRY, 10))


def four_channels() -> list[Any]:
    """Two odometries and a further topic beside the detections."""
    logs, out = writers(), []
    for number, message in enumerate(logs.drive(ODOMETRY, 10)):
        out.append(message)
        if message.topic == "/odom" and number % 3 == 0:
            out.append(replace(message, topic="/other", type_name=logs.POSE_STAMPED))
        if message.topic == "/odom" and number % 4 == 0:
            out.append(replace(message, topic="/odom2"))
    return out


def wrong_bit(log: Sound, rng: random.Random) -> int:
    """A bit of what holds a log together, of the front of a message, or of anything."""
    where = rng.randrange(10)
    if where == 9:
        return rng.randrange(8 * len(log.raw))
    span = rng.choice(log.spans if where < 5 else logs_flips.places(log))
    end = min(span.begin + HEAD, span.end) if where < 5 else span.end
    return 8 * rng.randrange(span.begin, end) + rng.randrange(8)


def problem(log: Sound, written: Counter[str], bit: int, path: Path) -> str:
    """What is wrong with how a log with one wrong bit is read, "" if nothing is.

    written: messages by topic. One with the number of another topic is missing of its own, which
    only an index tells.
    """
    from topobatch.topology.errors import LogError

    raw, _ = logs_flips.flipped(log, bit)
    path.write_bytes(raw)
    try:
        _, _, findings = read_of(path)
    except LogError:
        return ""  # told
    met: Counter[str] = Counter()
    for channel, count in sorted(
        findings.counts.items(), key=lambda met: met[0].topic not in written
    ):
        # Nothing tells that a topic's name is wrong: it is that of which most are missing.
        named = channel.topic in written
        met[channel.topic if named else max(written, key=(written - met).__getitem__)] += count
    missing = (written - met).total()
    if met.total() > log.messages:
        return f"{met.total()} messages, {log.messages} were written"
    if missing > (met - written).total() and not findings.damage:
        return f"silent loss: {missing} missing"
    return ""


def failures(name: str, tries: int, seed: int, folder: Path) -> Iterator[str]:
    """The tries of one kind of log that failed, a line for each."""
    rng = random.Random(f"{name} {seed}")
    for messages in (two_channels, four_channels):
        logs_flips.recorded = messages
        log = logs_flips.SOUND[name]()
        written = Counter(message.topic for message in messages())
        for _ in range(tries // 2):
            bit = wrong_bit(log, rng)
            found = problem(log, written, bit, folder / log.name)
            if found:
                yield f"{name}, {messages.__name__}: bit {bit % 8} of byte {bit // 8}: {found}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tries", type=int, default=1000, help="for each kind of log")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="kinds whose names hold this")
    arguments = parser.parse_args()
    names = [name for name in logs_flips.SOUND if arguments.only in name]
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            found = list(failures(name, arguments.tries, arguments.seed, Path(folder)))
            print(f"{name}: {arguments.tries} tries, {len(found)} failures", flush=True)
            print("".join(f"  {line}\n" for line in found[:20]), end="")
            failed += len(found)
    print(f"{len(names) * arguments.tries} tries, {failed} failures")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
