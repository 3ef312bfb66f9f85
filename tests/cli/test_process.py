"""Signals that end the process."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and signals of Linux")


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
