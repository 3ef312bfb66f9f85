"""Setup of worker processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading

from .process import ENDING


def start_worker() -> None:
    """Set up a worker process: it ignores Ctrl-C, which its parent handles, and ends with its
    parent, or when that ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # A process has the handlers of its parent or, from a server, what that blocks.
    for number in ENDING:
        signal.signal(number, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End the worker when its parent was killed, since no work will come."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
