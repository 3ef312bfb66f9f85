"""Tasks on executors whose processes die."""

import os
import signal
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import pytest

from topobatch.merge.workers import Workers
from topobatch.topology.errors import DataError


def squared(number):
    return number * number


def dies_once(mark, number):
    """The square of a number; of 3 only by a process that did not have to die for it."""
    if number == 3 and not Path(mark).exists():
        Path(mark).write_text("died")
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(number)


def fails(number):
    raise DataError(f"no {number}")


def test_what_a_task_raises_is_raised():
    with ThreadPoolExecutor(1) as pool, pytest.raises(DataError, match="no 5"):
        list(Workers(lambda: nullcontext(pool)).results(fails, [5]))


pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are of another kind")


def test_a_worker_that_dies_loses_nothing(tmp_path):
    workers = Workers(partial(ProcessPoolExecutor, 2))
    found = dict(workers.results(partial(dies_once, tmp_path / "mark"), range(40)))
    assert found == {k: k * k for k in range(40)}
    assert (tmp_path / "mark").exists()
