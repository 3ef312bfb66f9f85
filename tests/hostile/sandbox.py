"""Runs a call of the command in a process of its own, watched and limited from outside.

The process is forked from one that has imported most of what calls need, for an interpreter takes
longer to start than most calls. Linux alone.
"""

from __future__ import annotations

import gc
import os
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

POLL_S = 0.02
"""How often memory and time are looked at; the end of a process is noticed at once."""

NET_BYTES = 4 << 30
"""No process may allocate more, whatever the budget: the machine is not to suffer."""


@dataclass(frozen=True)
class Budget:
    """What a call may take: CPU time, memory above that of the interpreter, time by the clock."""

    cpu_s: float = 20.0
    memory_mb: float = 300.0
    wall_s: float = 120.0


@dataclass(frozen=True)
class Outcome:
    """What became of a call. code: its exit code, negative for a signal; over: the budget that it
    exceeded, for which it was ended, or ""."""

    code: int
    out: str
    err: str
    cpu_s: float
    memory_mb: float
    wall_s: float
    over: str = ""


def load() -> None:
    """Import what most calls import, so that few pay for it; rare paths import more by themselves.

    Memory is measured above what a process holds that was forked after this.
    """
    import apsw  # noqa: F401
    import dateutil.relativedelta  # noqa: F401
    import filelock  # noqa: F401
    import mcap.reader  # noqa: F401
    import rerun.blueprint  # noqa: F401
    import rosbags.rosbag1  # noqa: F401
    import scipy.optimize
    import scipy.sparse.linalg
    import scipy.spatial  # noqa: F401

    import topobatch.cli.ingest_worker
    import topobatch.cli.main
    import topobatch.merge.document
    import topobatch.merge.merging
    import topobatch.merge.paper.explain
    import topobatch.viz.draw_pair
    import topobatch.viz.map_recording
    import topobatch.viz.merged_recording  # noqa: F401

    # What is loaded stays in the memory that parent and children share.
    gc.collect()
    gc.freeze()


def command(arguments: Sequence[str | Path]) -> Callable[[], None]:
    """The command line, called with these arguments."""

    def call() -> None:
        from topobatch.cli.main import main

        sys.argv = ["topobatch", *map(str, arguments)]
        main()

    return call


class Child:
    """A forked process that makes a call; `finish` waits for it, within the budget."""

    def __init__(
        self,
        call: Callable[[], None],
        folder: Path,
        budget: Budget = Budget(),
        file_bytes: int | None = None,
    ) -> None:
        """folder: where its output is kept, and its temporary files; file_bytes: largest file that
        it can write, as on a disk that fills."""
        self._folder, self._budget = folder, budget
        (folder / "tmp").mkdir(parents=True, exist_ok=True)
        self._base_kb = _base_kb()
        self._started = time.monotonic()
        self.process = os.fork()
        if self.process == 0:
            os._exit(_within(call, folder, budget, file_bytes))
        os.setpgid(self.process, self.process)  # both do, for either may be first

    def kill(self) -> None:
        """End it and its own children at once."""
        os.killpg(self.process, signal.SIGKILL)

    def _shown(self, name: str) -> str:
        """What it printed; nothing where it was killed before it could open the file."""
        path = self._folder / name
        raw = path.read_bytes() if path.exists() else b""
        return raw.decode("utf-8", "backslashreplace")

    def finish(self) -> Outcome:
        """Wait for its end, or bring it about where a budget is exceeded."""
        over = ""
        ended = os.pidfd_open(self.process)
        while not select.select([ended], [], [], POLL_S)[0]:
            over = over or self._exceeded()
            if over:
                os.kill(self.process, signal.SIGKILL)
        os.close(ended)
        _, status, used = os.wait4(self.process, 0)
        cpu_s = used.ru_utime + used.ru_stime
        memory_mb = (used.ru_maxrss - self._base_kb) / 1024
        if not over and cpu_s > self._budget.cpu_s:
            over = f"CPU time: {cpu_s:.1f} s of {self._budget.cpu_s:.1f}"
        if not over and memory_mb > self._budget.memory_mb:
            over = f"memory: {memory_mb:.0f} MB of {self._budget.memory_mb:.0f}"
        return Outcome(
            os.waitstatus_to_exitcode(status),
            self._shown("out"),
            self._shown("err"),
            cpu_s,
            memory_mb,
            time.monotonic() - self._started,
            over,
        )

    def _exceeded(self) -> str:
        wall_s = time.monotonic() - self._started
        if wall_s > self._budget.wall_s:
            return f"time: no end after {wall_s:.0f} s"
        memory_mb = (_status(self.process, "VmRSS") - self._base_kb) / 1024
        # Somewhat more than the budget, so that a report says by how much it is exceeded.
        if memory_mb > 3 * self._budget.memory_mb + 100:
            return f"memory: {memory_mb:.0f} MB of {self._budget.memory_mb:.0f}"
        return ""


def _within(call: Callable[[], None], folder: Path, budget: Budget, file_bytes: int | None) -> int:
    """The exit code of a call, made in this process under its limits."""
    try:
        os.setpgid(0, 0)
        for number, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        cpu_s = int(2 * budget.cpu_s) + 5
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
        resource.setrlimit(resource.RLIMIT_DATA, (NET_BYTES, NET_BYTES))
        if file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
        os.environ["TMPDIR"] = str(folder / "tmp")
        tempfile.tempdir = None
        call()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1 if end.code else 0
    except BaseException:
        traceback.print_exc()
        code = 99
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    return code


@cache
def _base_kb() -> int:
    """Memory of a forked process that does nothing: what the interpreter takes."""
    process = os.fork()
    if process == 0:
        os._exit(0)
    return os.wait4(process, 0)[2].ru_maxrss


def _status(process: int, field: str) -> int:
    """A number of /proc/PID/status, 0 for a process that has ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith(field + ":")), 0)


def run(
    call: Callable[[], None], folder: Path, budget: Budget = Budget(), file_bytes: int | None = None
) -> Outcome:
    """Make a call in a process of its own, and wait for its end."""
    return Child(call, folder, budget, file_bytes).finish()
