"""The process as it was started: closed streams, signals that end it, lack of memory."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end the process as Ctrl-C does: what was begun is cleared away."""


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


def lack_of_memory(error: Exception) -> str | None:
    """That memory did not suffice, if that is what an error means."""
    words = ("failed to map segment", "can't start new thread")
    if not isinstance(error, MemoryError) and not any(word in str(error) for word in words):
        return None
    return f"not enough memory: {str(error) or 'none is left'}"


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
