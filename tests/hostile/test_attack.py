"""The attack in short; and that it would find what it looks for."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from judge import conduct, counts
from sandbox import Outcome

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are watched by /proc")

SHORT = (
    *("hostile documents", "no file", "names that", "among sound", "one time"),
    *("kill -9 of merge", "full disks", "tables of"),
)


def test_a_few_tries_find_nothing():
    """The long attack is `make attack`; logs are tried by tests of their own as well."""
    command = [sys.executable, str(HERE / "attack.py"), "--tries", "12", "--jobs", "1"]
    done = subprocess.run(
        [*command, "--seed", "7", "--only", ",".join(SHORT)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAILED" not in done.stdout
    assert "| **0** |" in done.stdout


CALLS = """
import json, sys, tempfile, time
from pathlib import Path
sys.path.insert(0, {here!r})
from sandbox import Budget, run
def hold():
    kept = bytearray(400_000_000)
    kept[::4096] = b"x" * len(kept[::4096])
    time.sleep(0.3)
def spin():
    while True: pass
def crash():
    raise RuntimeError("defect")
def fill():
    Path("/proc/self/fd/1").write_bytes(b"x" * 100_000)
with tempfile.TemporaryDirectory() as folder:
    budget = Budget(cpu_s=1, memory_mb=100, wall_s=4)
    calls = {{"hold": hold, "spin": spin, "crash": crash, "wait": lambda: time.sleep(60)}}
    found = {{name: run(call, Path(folder), budget) for name, call in calls.items()}}
    found["fill"] = run(fill, Path(folder), budget, file_bytes=10_000)
    print(json.dumps({{k: [v.code, v.over, v.err] for k, v in found.items()}}))
"""


def test_budgets_are_enforced_from_outside():
    program = [sys.executable, "-W", "error", "-c", CALLS.format(here=str(HERE))]
    done = subprocess.run(program, capture_output=True, text=True, check=True, timeout=120)
    found = json.loads(done.stdout)
    assert found["hold"][1].startswith("memory: ")
    assert found["wait"][:2] == [-9, "time: no end after 4 s"]
    assert found["spin"][0] == -9
    assert "RuntimeError: defect" in found["crash"][2]
    assert "File too large" in found["fill"][2]


def outcome(code: int = 0, out: str = "", err: str = "", over: str = "") -> Outcome:
    return Outcome(code, out, err, 0.1, 1.0, 0.1, over)


@pytest.mark.parametrize(
    "bad",
    [
        outcome(70, err="error: internal error, please report it: ValueError: x\n"),
        outcome(-9),
        outcome(1, err="error: a.mcap: internal error, please report it\n"),
        outcome(1),
        outcome(1, err="Traceback (most recent call last):\n"),
        outcome(out="run \x1b[31mred\n"),
        outcome(out="run \u202e\n"),
        outcome(0, err="something else\n"),
        outcome(over="memory: 400 MB of 300"),
    ],
)
def test_bad_conduct_is_found(bad):
    assert conduct(bad)


@pytest.mark.parametrize(
    ("found", "told", "intact", "lost", "problem"),
    [
        (100, [], 100, 0, ""),
        (97, ["the log is cut short"], 97, 3, ""),
        (97, [], 97, 3, "silent loss"),
        (101, [], 100, 0, "more than were written"),
        (90, ["the log is cut short"], 97, 3, "of 97 intact"),
        (100, ["/odom: 50 messages could not be decoded; left out"], 100, 0, "of 100 intact"),
        (5, [], None, None, ""),
    ],
)
def test_messages_are_counted_against_the_truth(found, told, intact, lost, problem):
    said = counts(found, told, intact, lost)
    assert problem in said
    assert bool(problem) == bool(said)
