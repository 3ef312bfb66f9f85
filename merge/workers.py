"""Tasks side by side: on any `concurrent.futures.Executor`, here if there is none.

A worker that dies takes an executor of processes with it: what was not finished is then given to a
new one. Tasks are pure, so that doing one twice changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TypeVar

from ..topology.errors import DataError

Task = TypeVar("Task")
Result = TypeVar("Result")

TRIES = 4
"""Executors that a stage may use up, as a task on a Dask cluster may three workers."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Where tasks are done. start: an executor, to be entered, and again if it breaks; worth: for
    fewer pairs than this it is not worth the trouble."""

    start: Callable[[], AbstractContextManager[Executor]]
    worth: int = 0

    def results(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """The number of each task and its result, as they come. Raises what a task raises, and
        DataError where workers keep dying."""
        left = dict(enumerate(tasks))
        for _ in range(TRIES):
            with self.start() as executor:
                try:
                    jobs = {executor.submit(function, task): k for k, task in left.items()}
                    for job in as_completed(jobs):
                        result = job.result()
                        del left[jobs[job]]
                        yield jobs[job], result
                except (BrokenExecutor, CancelledError):
                    continue
            return
        raise DataError(
            f"the processes that match were killed {TRIES} times (out of memory?); what they had "
            "done is kept: call again, with fewer --jobs"
        )
