"""The attack in short; and that it would find what it looks for."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from judge import conduct, counts, halves, left_overs, print_of, told
from sandbox import Outcome
from trials import Victim

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are watched by /proc")

SHORT = (
    *("hostile documents", "hostile cache", "no file", "names that", "among sound", "one time"),
    *("kill -9 of merge", "full disks", "links in", "tables of", "mappings of"),
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


def test_good_conduct_is_none():
    for good in (
        outcome(),
        outcome(1, err="error: x\nwarning: y\n"),
        outcome(1, out="problem: x\n"),
        outcome(2, err="Usage: z\n"),
    ):
        assert conduct(good) == ""


def test_what_has_to_be_said_is_looked_for():
    spoken = outcome(1, err="error: a.mcap: /odom cannot be decoded\n")
    assert told(spoken, r"/odom|odometry") == told(outcome(), "") == ""
    assert told(spoken, "protobuf")


LOST = "3 messages of /odom are lost in damaged places"


@pytest.mark.parametrize(
    ("found", "told", "intact", "lost", "problem"),
    [
        (100, [], 100, 0, ""),
        (97, [LOST], 97, 3, ""),
        (97, ["the log is cut short"], 97, 3, ""),
        (97, [], 97, 3, "silent loss"),
        (96, [LOST], 96, 4, "wrong count"),
        (98, [LOST], 97, 3, "wrong count"),
        (101, [], 100, 0, "more than were written"),
        (90, [LOST], 97, 3, "of 97 intact"),
        (100, ["/odom: 50 messages could not be decoded; left out"], 100, 0, "of 100 intact"),
        (5, [], None, None, ""),
    ],
)
def test_messages_are_counted_against_the_truth(found, told, intact, lost, problem):
    said = counts(found, told, intact, lost)
    assert problem in said
    assert bool(problem) == bool(said)


def test_what_is_touched_halved_or_left_over_is_found(tmp_path):
    victim = Victim(tmp_path / "victim")
    assert victim.touched() == ""
    (victim.folder / "x.json").unlink()
    assert victim.touched()
    maps = tmp_path / "maps"
    maps.mkdir()
    (maps / "a.json").write_text("{}")
    assert "a" in halves(tmp_path)
    (maps / "a.rrd").write_text("")
    assert halves(tmp_path) == left_overs(maps) == ""
    (maps / ".topobatch-abcdefgh.tmp").write_text("")
    assert left_overs(maps)
    before = print_of(tmp_path)
    os.utime(maps / "a.json")
    assert print_of(tmp_path) == before
    (maps / "a.json").write_text("{ }")
    assert print_of(tmp_path) != before
