"""A Dask cluster to match on: `--cluster tcp://…`, of the extra `topobatch[cluster]`.

Its workers need the same topobatch, and the workspace under the same path.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from ..topology.errors import DataError, UsageError

CONNECT_S = 20
"""Timeout of the connection to a scheduler."""


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The executor of a running cluster. UsageError if Dask is not installed or the address is
    invalid, DataError if nobody answers or workers keep dying."""
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise UsageError(
            "--cluster needs Dask: python -m pip install 'topobatch[cluster]'"
        ) from error
    _check(address)
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError as error:
        raise DataError(f"--cluster {address}: no scheduler answers there") from error
    with client:
        try:
            # Tasks are identified by their order; hashing them is not needed.
            yield client.get_executor(pure=False)
        except KilledWorker as error:
            raise DataError(
                f"--cluster {address}: the workers that match die again and again (out of "
                "memory?); what they had done is kept: call again"
            ) from error


def require_cluster(address: str) -> None:
    """Raise as `cluster` if none is there, also where nothing would need it."""
    with cluster(address):
        pass


def _check(address: str) -> None:
    """UsageError for an address that is none: of one that is tried, Dask tells for a minute."""
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    try:
        scheme, place = parse_address(address)
        get_backend(scheme)
        if scheme != "inproc" and not 0 < parse_host_port(place)[1] < 1 << 16:
            raise ValueError("its port must lie in 1 … 65535")
    except ValueError as error:
        raise UsageError(f"--cluster {address}: {error}") from error
