"""`topobatch ingest` of many logs in parallel processes with a common progress count."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from ..ingest.read_cost import read_cost
from ..ingest.remote.path import RemotePath
from ..ingest.remote.threads import side_by_side
from ..topology.errors import TopobatchError
from ..topology.wording import counted
from .ingest_worker import IngestJob, IngestOutcome, ingest_one, is_unchanged, job_size
from .output import Screen
from .process import ENDING, start_worker

POLL_S = 0.1
"""Interval of progress updates."""

TOGETHER = 2
"""Attempts at reading logs in parallel if processes die; after that one by one."""


def outcomes_of(
    jobs: list[IngestJob], workers: int, advance: Callable[[int], None]
) -> Generator[IngestOutcome, None, None]:
    """Outcomes as they are completed; `advance` is called with the bytes read so far over all
    logs."""
    if workers == 1:
        done = 0

        def on_bytes(more: int) -> None:
            nonlocal done
            done += more
            advance(done)

        yield from (ingest_one(job, on_bytes) for job in jobs)
        return
    left = list(jobs)
    for _ in range(TOGETHER):
        unfinished = []
        for job, outcome in _side_by_side(left, workers, advance):
            if outcome is None:
                unfinished.append(job)
            else:
                yield outcome
        left = unfinished
    for job in left:  # one by one: a log that ends its process costs no other
        for _, outcome in _side_by_side([job], 1, advance):
            text = f"{job.log}: the process that read it was killed (out of memory?)"
            yield outcome or IngestOutcome(job.run, "failed", text)


def _side_by_side(
    jobs: Sequence[IngestJob], workers: int, advance: Callable[[int], None]
) -> Iterator[tuple[IngestJob, IngestOutcome | None]]:
    """Jobs with their outcomes; None if the processes ended before."""
    if not jobs:
        return
    context = _context()
    counter, begin = context.Value("q", 0), context.Semaphore(0)
    with ProcessPoolExecutor(workers, context, _start_worker, (counter, begin)) as pool:
        try:
            with _signals_deferred():  # a worker stopped half-started would complain
                futures = dict(_submitted(pool, jobs))
            # A process that dies while others are started can block the pool for good; one that
            # dies waiting for an Event, who sets it.
            for _ in range(workers):
                begin.release()
            yield from ((job, None) for job in jobs[len(futures) :])
            waiting = set(futures)
            while waiting:
                finished, waiting = wait(waiting, POLL_S, FIRST_COMPLETED)
                advance(counter.value)
                for future in finished:
                    yield futures[future], _result(future)
        except BaseException:  # Ctrl-C: nobody waits for half-read logs
            for process in multiprocessing.active_children():
                process.terminate()
                process.join()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


_bytes_done: Any = None  # in a worker process: the counter shared with the parent


def _start_worker(counter: Any, begin: Any) -> None:
    global _bytes_done  # noqa: PLW0603 - set once per worker process
    _bytes_done = counter
    start_worker()
    begin.acquire()


def _counted(job: IngestJob) -> IngestOutcome:
    """`ingest_one` in a worker process, with its progress added to the shared counter."""

    def on_bytes(more: int) -> None:
        with _bytes_done.get_lock():
            _bytes_done.value += more

    return ingest_one(job, on_bytes)


@contextmanager
def _signals_deferred() -> Iterator[None]:
    """Defers Ctrl-C and other signals that end the process in the body to its end."""
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, *ENDING)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in came:
        signal.raise_signal(number)


def _submitted(
    pool: ProcessPoolExecutor, jobs: Sequence[IngestJob]
) -> Iterator[tuple[Future[IngestOutcome], IngestJob]]:
    """The submitted jobs, as long as all processes live."""
    for job in jobs:
        try:
            yield pool.submit(_counted, job), job
        except (BrokenProcessPool, EOFError, ConnectionError):  # the last two: no server any more
            return


def _result(future: Future[IngestOutcome]) -> IngestOutcome | None:
    try:
        return future.result()
    except BrokenProcessPool:
        return None


def _context() -> Any:
    """Workers are forked from a server that has imported everything once, where available."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["topobatch.cli.ingest_pool", "rerun"])
    # Signals to a terminal's or a service's processes reach the server and the tracker that it
    # needs as well, and would end them before their time. Both begin with what is blocked here. The
    # tracker would unblock Ctrl-C and SIGTERM again, also here, and ignores them itself.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *ENDING})
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return context


KEPT_BYTES = 1 << 28
"""Limit on index bytes kept; those of further logs are requested again."""


def announce(jobs: Sequence[IngestJob], screen: Screen) -> None:
    """Read the indexes of all remote logs to be ingested, and print the bytes to fetch."""
    remote = [job for job in jobs if isinstance(job.log, RemotePath)]
    if not remote:
        return
    logs = fetched = whole = kept = 0
    with screen.progress("indexes", len(remote), "logs") as at:
        costs = side_by_side(_cost, remote)
        for done, (job, cost) in enumerate(zip(remote, costs, strict=True)):
            at(done + 1)
            if cost is None:
                continue
            assert isinstance(job.log, RemotePath)
            logs, fetched, whole = logs + 1, fetched + cost, whole + job_size(job)
            kept += job.log.kept_bytes
            if kept > KEPT_BYTES:
                job.log.forget()
    screen.line(
        f"to read: {fetched / 1e6:,.1f} of {whole / 1e6:,.1f} MB in {counted(logs, 'remote log')}"
    )


def _cost(job: IngestJob) -> int | None:
    """Bytes to fetch; None for a log that is finished or cannot be read."""
    assert isinstance(job.log, RemotePath)
    try:
        return None if is_unchanged(job) else read_cost(job.log, job.read)
    except (TopobatchError, OSError):
        return None  # reading it will say why
