"""Parallel tasks on any `concurrent.futures.Executor`.

A worker process that dies breaks its executor: unfinished tasks are then given to a new one. Tasks
are pure, so that repeating one changes nothing.
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
"""Executors that a stage may use up, as a task on a Dask cluster may use up workers."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Where tasks run. start: makes an executor, to be entered, and again if it breaks; worth:
    less work than so many pairs of maps without views is done without it."""

    start: Callable[[], AbstractContextManager[Executor]]
    worth: int = 0

    def results(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """The index of each task and its result, as they complete. Raises what a task raises, and
        DataError if workers keep dying."""
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
