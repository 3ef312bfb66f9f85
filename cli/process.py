"""The process as it was started: closed streams, signals that end it, limits of memory."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

from ..topology.errors import UsageError

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end the process as Ctrl-C does: what was begun is cleared away."""

LEAST_BYTES = 1 << 31
"""Address space that is needed: the libraries map 0.8 GB, and threads 72 MB each (stack and heap).
Measured on the sample logs: with 2.0 GiB every command works, with 1.5 GiB neither `explain` nor
`ingest -j 2`. With less, OpenBLAS waits for ever or ends the process."""


def open_closed_streams() -> None:
    """Open standard streams that were closed (`2>&-`, daemons) on the null device, so that no file
    that is opened later takes their place. To be called first."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)
            os.dup2(handle, number)
            if handle != number:
                os.close(handle)
            os.set_inheritable(number, True)
            stream = os.fdopen(number, mode, encoding="utf-8", closefd=False)
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


def memory_limit() -> int | None:
    """Bytes of address space that the process may have (`ulimit -v`); None without a limit."""
    try:
        import resource
    except ImportError:
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


def require_memory() -> None:
    """UsageError if the process may not have the address space that the libraries need."""
    limit = memory_limit()
    if limit is not None and limit < LEAST_BYTES:
        raise UsageError(
            f"memory is limited to {limit >> 20} MiB (ulimit -v {limit >> 10}), and "
            f"{LEAST_BYTES >> 20} MiB of addresses are needed: ulimit -v {LEAST_BYTES >> 10}"
        )


def lack_of_memory(error: Exception) -> str | None:
    """That memory did not suffice, if that is what an error means."""
    words = ("failed to map segment", "can't start new thread")
    if not isinstance(error, MemoryError) and not any(word in str(error) for word in words):
        return None
    limit = memory_limit()
    limited = "" if limit is None else f", which is limited to {limit >> 20} MiB (ulimit -v)"
    return f"not enough memory{limited}: {str(error) or 'none is left'}"


def start_worker() -> None:
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


def _end_with_parent() -> None:
    """End the worker when its parent was killed, since no work will come."""
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
