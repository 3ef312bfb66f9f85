"""`topobatch ingest` of many logs in several processes, with a common progress count."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any

from .ingest_worker import IngestJob, IngestOutcome, ingest_one
from .process import ENDING, start_worker


def outcomes_of(
    jobs: Sequence[IngestJob], workers: int, advance: Callable[[int], None]
) -> Generator[IngestOutcome, None, None]:
    """Outcomes as they are completed; `advance` is called with the bytes read so far over all
    logs."""
    done = 0

    def on_bytes(more: int) -> None:
        nonlocal done
        done += more
        advance(done)

    if workers == 1:
        yield from (ingest_one(job, on_bytes) for job in jobs)
        return
    lost = []
    for job, outcome in _side_by_side(jobs, workers, on_bytes):
        if outcome is None:
            lost.append(job)
        else:
            yield outcome
    # Once more one by one: each has all memory for itself, and ends no process but its own.
    for job, outcome in _side_by_side(lost, 1, on_bytes):
        text = f"{job.log}: the process that read it was killed (out of memory?)"
        yield outcome or IngestOutcome(job.run, "failed", text)


def _side_by_side(
    jobs: Sequence[IngestJob], workers: int, on_bytes: Callable[[int], None]
) -> Iterator[tuple[IngestJob, IngestOutcome | None]]:
    """Jobs with their outcomes; None if the process ended before. on_bytes: called with the number
    of further bytes read."""
    context, waiting = _context(), list(reversed(jobs))
    running: dict[Connection, tuple[Any, IngestJob]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                ours, theirs = context.Pipe()
                process = context.Process(target=_ingest, args=(theirs,))
                process.start()
                theirs.close()
                running[ours] = process, waiting.pop()
                _send(ours, running[ours][1])
            for pipe in wait([*running]):
                assert isinstance(pipe, Connection)
                told = _received(pipe)
                if isinstance(told, int):
                    on_bytes(told)
                    continue
                process, job = running.pop(pipe)
                if told is not None and waiting and _send(pipe, waiting[-1]):
                    running[pipe] = process, waiting.pop()
                else:
                    pipe.close()  # ends the process
                    process.join()
                yield job, told
    finally:  # Ctrl-C: nobody waits for half-read logs
        for process, _ in running.values():
            process.terminate()
        for process, _ in running.values():
            process.join()


def _send(pipe: Connection, job: IngestJob) -> bool:
    """Whether the process was still there to receive a job."""
    try:
        pipe.send(job)
    except OSError:
        return False
    return True


def _received(pipe: Connection) -> Any:
    """What comes next through a pipe: for a process a job, from it the number of further bytes read
    or an outcome; None if the other side has ended."""
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None


def _ingest(pipe: Connection) -> None:
    """`ingest_one` of the jobs that come, in a process of its own."""
    start_worker()
    while (job := _received(pipe)) is not None:
        pipe.send(ingest_one(job, pipe.send))


def _context() -> Any:
    """Workers are forked from a server that has imported everything once, where available."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["topobatch.cli.ingest_pool", "rerun"])
    # Signals to a terminal's or a service's processes reach the server as well, and would end it
    # before its time. It begins with what is blocked here. Its tracker would unblock them again.
    resource_tracker.ensure_running()
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *ENDING})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return context
