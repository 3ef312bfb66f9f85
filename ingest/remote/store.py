"""Requests to object stores and web servers by obstore: byte ranges, and listings below a prefix.

Errors become LogErrors that name bucket and key. obstore repeats requests that fail, stall or are
cut off; responses are checked for range, length, and an unchanged object. Requests run on daemon
threads: waiting for them can be interrupted, unlike waiting in obstore, and Ctrl-C ends the program
at once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from datetime import timedelta
from functools import lru_cache, partial
from threading import Thread
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from ...topology.errors import LogError, UsageError

if TYPE_CHECKING:
    from obstore import GetOptions
    from obstore.store import ClientConfig, ObjectStore, RetryConfig

R = TypeVar("R")

CLIENT: ClientConfig = {
    "connect_timeout": timedelta(seconds=10),
    "read_timeout": timedelta(seconds=30),  # without any byte; botocore's default is 60 s
    "timeout": timedelta(minutes=5),  # for one response: enough for 4 MiB at 14 kB/s
    "allow_http": True,  # for who names an address or endpoint that begins so
}
RETRIES: RetryConfig = {
    "max_retries": 6,
    "retry_timeout": timedelta(minutes=2),  # after which no further attempt is begun
    "backoff": {
        "init_backoff": timedelta(milliseconds=200),
        "max_backoff": timedelta(seconds=10),
        "base": 2,
    },
}
"""obstore's options."""


class Stat(NamedTuple):
    """What identifies a state of an object.

    etag: empty if there is none; modified_s: Unix time in whole seconds, since listings are more
    precise than responses, 0 if there is none.
    """

    size: int
    etag: str
    modified_s: int

    @property
    def st_size(self) -> int:
        """Its size, as of a file."""
        return self.size


class Got(NamedTuple):
    """Bytes from `start` on, and the object's state when they were sent."""

    start: int
    data: bytes
    stat: Stat


class MissingObjectError(LogError):
    """There is no such object, bucket or page."""


def requested(
    root: str, key: str, wanted: tuple[int, int] | int, known: Stat | None, *, named: str
) -> Future[Got]:
    """Start one request. wanted: first byte and the one after the last, or a number of bytes at the
    end.

    known: the state that the object must still have, if known. The result raises
    MissingObjectError, or LogError with `named` as prefix.
    """
    return begun(partial(_answer, root, key, wanted, known, named))


def _answer(
    root: str, key: str, wanted: tuple[int, int] | int, known: Stat | None, named: str
) -> Got:
    import obstore

    if isinstance(wanted, int) and root.startswith("az:"):
        # Azure does not support suffix ranges.
        with _translated(named):
            known = known or _stat(obstore.head(store(root), key))
        wanted = max(0, known.size - wanted), known.size
    options: GetOptions = {"range": {"suffix": wanted} if isinstance(wanted, int) else wanted}
    if known is not None and known.etag and not known.etag.startswith("W/"):
        options["if_match"] = known.etag
    with _translated(named):
        answer = obstore.get(store(root), key, options=options)
        start, stop = answer.range
        stat = _stat(answer.meta)
        if known is not None and not _same(known, stat):
            raise LogError(f"{named}: changed while it was read; read it again")
        data = bytes(answer.bytes())
    if len(data) != stop - start:
        raise LogError(
            f"{named}: the server sent {len(data)} of the {stop - start} bytes it announced"
        )
    if isinstance(wanted, tuple) and (start, stop) != (wanted[0], min(wanted[1], stat.size)):
        raise LogError(f"{named}: the server sent bytes {start} to {stop} in place of {wanted}")
    return Got(start, data, stat)


def _same(known: Stat, now: Stat) -> bool:
    """Whether the object is unchanged, by its tag or, without one, its time."""
    if known.etag and now.etag:
        return (known.size, known.etag) == (now.size, now.etag)
    times = known.modified_s, now.modified_s
    return known.size == now.size and (times[0] == times[1] or not all(times))


def listed(root: str, prefix: str, *, named: str) -> Iterator[tuple[str, Stat]]:
    """Every key below a prefix, as a folder, with its object's state; others that a server sends
    are left out."""
    import obstore

    folder = prefix and f"{prefix}/"
    with _translated(named):
        pages = obstore.list(store(root), prefix or None, chunk_size=1000)
        while page := begun(partial(next, pages, ())).result():
            for meta in page:
                if meta["path"].startswith(folder):
                    yield meta["path"], _stat(meta)


def _stat(meta: Any) -> Stat:
    return Stat(meta["size"], meta["e_tag"] or "", int(meta["last_modified"].timestamp()))


def require_obstore(named: str) -> None:
    """UsageError if the extra is not installed."""
    try:
        import obstore  # noqa: F401
    except ImportError as error:
        raise UsageError(
            f"{named}: reading it needs obstore: python -m pip install 'topobatch[remote]'"
        ) from error


@lru_cache(maxsize=64)
def store(root: str) -> ObjectStore:
    """The store of a bucket or server, configured by the environment."""
    from obstore.store import from_url

    return from_url(root, client_options=CLIENT, retry_config=RETRIES)


@contextmanager
def _translated(named: str) -> Iterator[None]:
    """obstore's errors as ours, without requests, responses and internals."""
    from obstore.exceptions import BaseError

    try:
        yield
    except (BaseError, ValueError, OSError) as error:
        missing = isinstance(error, FileNotFoundError)
        raise (MissingObjectError if missing else LogError)(f"{named}: {_why(error)}") from error


_CREDENTIALS = (
    "no credentials were found in the environment: AWS_ACCESS_KEY_ID, AZURE_STORAGE_ACCOUNT_NAME, "
    "GOOGLE_APPLICATION_CREDENTIALS and so on, or AWS_SKIP_SIGNATURE=true for a public bucket; see "
    "docs/remote.md"
)
_RANGES = "the server does not send parts of files (range requests); copy the log here"
_MEANT = (
    ("PreconditionError", "changed while it was read; read it again"),
    ("NoSuchBucket", "no such bucket"),
    ("NotFoundError", "no such object"),
    ("InvalidPathError", "a key cannot be read by its name; name other prefixes"),
    ("PermissionDeniedError", "access is denied"),
    ("UnauthenticatedError", "access is denied"),
    ("Range request not supported", _RANGES),
    ("non-partial response", _RANGES),
    ("http://169.254.169.254/", _CREDENTIALS),
    ("MissingAccount", _CREDENTIALS),
    ("TokenRequest", _CREDENTIALS),
    ("TimedOut", "cannot be read: the server does not answer"),
)
"""What an error with such a word in its type or text means."""


def _why(error: Exception) -> str:
    """The reason of an error from its type and text: without addresses, whose query may be a
    signature."""
    kind, text = type(error).__name__, str(error)
    for word, meaning in _MEANT:
        if word in f"{kind} {text}":
            return meaning
    cause = re.search(r'message: "([^"]+)"', text)
    line = cause[1] if cause else text.strip().partition("\n")[0]
    return f"cannot be read: {re.sub(r'https?://[^ ]+', 'the server', line)[:200]}"


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
