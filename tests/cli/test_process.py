"""The process as it was started: closed streams, broken pipes, signals."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and signals of Linux")


def shell(line: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A line of sh, in which "$@" is topobatch with these arguments."""
    command = ["sh", "-c", line, "sh", sys.executable, "-m", "topobatch.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def test_closed_streams_are_no_error(logs, tmp_path):
    """As daemons are started. What is written there is lost, and goes into no file."""
    call = ("ingest", logs["mcap"], tmp_path / "none.bag", "-w", tmp_path / "ws")
    done = shell('"$@" <&- >&- 2>&-', *call)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")
    assert (tmp_path / "ws" / "maps" / "run1.json").is_file()
    assert not any(
        b"no such file" in path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()
    )


def test_a_reader_who_has_enough_is_no_error():
    done = shell('"$@" | head -1', "schema", "map")
    assert (done.stdout, done.stderr) == ("{\n", "")


def test_signals_end_it_quietly(logs, tmp_path):
    """Also while it has worker processes, of which Python's resource tracker would tell: what is
    kept is all that is said."""
    call = ["ingest", logs["mcap"], logs["other"], "-j", "2", "-w", str(tmp_path / "ws")]
    process = subprocess.Popen(
        [sys.executable, "-m", "topobatch.cli", *map(str, call)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    # Workers are there as soon as a first log is held.
    while not (tmp_path / "ws" / ".lock").exists() and process.poll() is None:
        time.sleep(0.01)
    time.sleep(1)
    os.killpg(process.pid, signal.SIGTERM)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM, out
    assert re.fullmatch(r"\d of 2 logs finished; run again to go on\n", err)
