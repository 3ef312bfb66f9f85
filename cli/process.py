"""The process as it was started: closed streams, signals that end it, lack of memory; and other
processes beside it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from concurrent.futures import Executor

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end the process as Ctrl-C does: what was begun is cleared away."""


def open_closed_streams() -> None:
    """Open standard streams that were closed (`2>&-`, daemons) on the null device, so that no file
    that is opened later takes their place. To be called first: each gets the lowest free number,
    which is its own."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode, encoding="utf-8")  # noqa: SIM115  for good
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)


def end_by_signals() -> None:
    """Let signals that end the process raise SystemExit, once; one that is ignored (nohup) stays
    so."""
    for number in ENDING:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end)


def _end(number: int, _: FrameType | None) -> None:
    signal.signal(number, signal.SIG_DFL)
    # By shell convention.
    raise SystemExit(128 + number)


def lack_of_memory(error: Exception) -> str | None:
    """That memory did not suffice, if that is what an error means."""
    words = ("failed to map segment", "can't start new thread")
    if not isinstance(error, MemoryError) and not any(word in str(error) for word in words):
        return None
    return f"not enough memory: {str(error) or 'none is left'}"


@contextmanager
def processes(
    number: int, context: Any = None, begin: Callable[..., None] | None = None, *given: Any
) -> Iterator[Executor]:
    """A pool of processes, started as needed, which end when the block is left by an error or
    Ctrl-C, whatever they do. begin: called in each of them first, with the further arguments."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    with ProcessPoolExecutor(number, context, _start_worker, (begin, given)) as pool:
        try:
            yield pool
        except BaseException:
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _start_worker(begin: Callable[..., None] | None, given: tuple[Any, ...]) -> None:
    """Set up a worker process: it ignores Ctrl-C, which its parent handles, and ends with its
    parent, or when that ends it."""
    import threading

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # A process has the handlers of its parent or, from a server, what that blocks.
    for number in ENDING:
        signal.signal(number, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if begin is not None:
        begin(*given)


def _end_with_parent() -> None:
    """End the worker when its parent was killed, since no work will come."""
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def forking_server(*modules: str) -> Any:
    """The context of processes that are forked from a server that has imported these modules once,
    where available."""
    import multiprocessing

    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(modules))
    # Signals to a terminal's or a service's processes reach the server as well, and would end it
    # before its time. It begins with what is blocked here. Its tracker would unblock them again.
    resource_tracker.ensure_running()
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *ENDING})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    # Until it has imported all, a signal would leave processes behind that nobody waits for.
    ready = context.Process(target=int)
    ready.start()
    ready.join()
    return context
