"""Shared by the tests of ingest."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from types import ModuleType
from typing import Any

import obstore
import pytest
from obstore.store import S3Store

from topobatch.ingest.remote import store
from topobatch.ingest.remote.path import RemotePath

from . import log_writers, scan_logs


@pytest.fixture(scope="session")
def logs() -> ModuleType:
    """The writers of logs."""
    return log_writers


@pytest.fixture(scope="session")
def sensors() -> ModuleType:
    """Messages of lasers, clouds and grids."""
    return scan_logs


@pytest.fixture(scope="session")
def servers() -> ModuleType:
    """An S3 server, one that fails on demand, and a web server."""
    from . import servers as module

    return module


@pytest.fixture(scope="session")
def s3_port(servers: ModuleType) -> Iterator[int]:
    with servers.s3_server() as port:
        yield port


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Retries follow each other quickly."""
    pauses = {"init_backoff": timedelta(seconds=0.01), "max_backoff": timedelta(seconds=0.05)}
    quick = {"max_retries": 3, "retry_timeout": timedelta(seconds=10), "backoff": pauses}
    monkeypatch.setattr(store, "RETRIES", quick)
    store.store.cache_clear()
    yield
    store.store.cache_clear()


@dataclass
class Bucket:
    """A bucket; `proxy` records what is asked of it, and spoils answers."""

    name: str
    proxy: Any
    port: int

    @property
    def url(self) -> str:
        return f"s3://{self.name}"

    def put(self, key: str, data: bytes) -> None:
        """Past the proxy."""
        obstore.put(S3Store(self.name, endpoint=f"http://127.0.0.1:{self.port}"), key, data)

    def path(self, key: str = "", *, allow_scan: bool = False) -> RemotePath:
        return RemotePath.parse(f"{self.url}/{key}", allow_scan=allow_scan)


@pytest.fixture
def bucket(
    servers: ModuleType, s3_port: int, impatient: None, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Bucket]:
    upstream = servers.forwarding(s3_port)
    with servers.running(servers.Recorder(upstream)) as proxy:
        for name, value in (
            ("AWS_ACCESS_KEY_ID", "key"),
            ("AWS_SECRET_ACCESS_KEY", "secret"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_ENDPOINT_URL", f"http://127.0.0.1:{proxy.port}"),
        ):
            monkeypatch.setenv(name, value)
        made = Bucket(f"b{uuid.uuid4().hex}", proxy, s3_port)
        assert upstream(servers.Request("PUT", f"/{made.name}", {}), b"").status == 200
        yield made
