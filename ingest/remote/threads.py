"""Requests on daemon threads, which do not delay the end of the program.

Waiting for a result can be interrupted, unlike waiting in obstore; and Ctrl-C ends the program at
once, where an executor of the standard library would wait for all requests.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from functools import partial
from threading import Thread
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

AT_ONCE = 16
"""Small requests at a time: each takes about 30 ms, nearly all of it waiting."""


def begun(call: Callable[[], R]) -> Future[R]:
    """Start a call on a thread of its own."""
    future: Future[R] = Future()

    def run() -> None:
        try:
            future.set_result(call())
        except BaseException as error:
            future.set_exception(error)

    Thread(target=run, daemon=True).start()
    return future


def side_by_side(function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """The results of a function computed concurrently, in the order of the items."""
    waiting: deque[Future[R]] = deque()
    for item in items:
        if len(waiting) == AT_ONCE:
            yield waiting.popleft().result()
        waiting.append(begun(partial(function, item)))
    while waiting:
        yield waiting.popleft().result()
