"""Servers for the tests: a real S3 server, a proxy in front of it that fails on demand, and files
served over HTTP. The last two keep a record of what was asked and how much was sent."""

from __future__ import annotations

import http.client
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

MOTO = """
import sys
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
sys.stdin.read()
"""


@contextmanager
def s3_server() -> Iterator[int]:
    """The port of moto's S3 server, which is another process; ends with the context."""
    call = [sys.executable, "-W", "ignore", "-c", MOTO]
    with subprocess.Popen(
        call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as server:
        assert server.stdout is not None
        yield int(server.stdout.readline())
        server.communicate()


@dataclass
class Request:
    """What was asked, and how many bytes of the body were sent."""

    method: str
    path: str
    headers: dict[str, str]
    sent: int = 0
    status: int = 0

    @property
    def range(self) -> str:
        return self.headers.get("range", "")


@dataclass
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes


@dataclass
class Fault:
    """How an answer is spoilt. None of a field leaves it as it is.

    cut_at, stall_at: bytes after which the connection is closed, or nothing more comes; pause_s:
    before every 4 KiB.
    """

    cut_at: int | None = None
    stall_at: int | None = None
    pause_s: float = 0.0
    answer: Callable[[Answer], Answer] | None = None


@dataclass
class Recorder:
    """A server in threads of this process.

    upstream: gives the answer to a request; fault: how to spoil it, by the request and how many
    were made before.
    """

    upstream: Callable[[Request, bytes], Answer]
    fault: Callable[[Request, int], Fault | None] = lambda request, before: None
    requests: list[Request] = field(default_factory=list)
    port: int = 0
    stopping: threading.Event = field(default_factory=threading.Event)

    @property
    def gets(self) -> list[Request]:
        """Requests for objects, not for listings."""
        return [r for r in self.requests if r.method == "GET" and "list-type" not in r.path]

    @property
    def sent(self) -> int:
        return sum(request.sent for request in self.gets)

    def clear(self) -> None:
        self.requests.clear()
        self.fault = lambda request, before: None


@contextmanager
def running(recorder: Recorder) -> Iterator[Recorder]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None:
            pass

        def answer(self) -> None:
            length = int(self.headers.get("Content-Length") or 0)
            request = Request(
                self.command, self.path, {k.lower(): v for k, v in self.headers.items()}
            )
            fault = recorder.fault(request, len(recorder.requests)) or Fault()
            recorder.requests.append(request)
            answer = recorder.upstream(request, self.rfile.read(length))
            if fault.answer is not None:
                answer = fault.answer(answer)
            request.status = answer.status
            try:
                self.send(request, answer, fault)
            except OSError:
                self.close_connection = True

        do_GET = do_HEAD = do_PUT = do_DELETE = do_POST = answer  # noqa: N815

        def send(self, request: Request, answer: Answer, fault: Fault) -> None:
            self.send_response(answer.status)
            headers = {"Content-Length": str(len(answer.body))} | answer.headers
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()
            if request.method == "HEAD":
                return
            for at in range(0, len(answer.body), 4096):
                piece = answer.body[at : at + 4096]
                for limit in (fault.cut_at, fault.stall_at):
                    piece = piece if limit is None else piece[: max(0, limit - at)]
                time.sleep(fault.pause_s)
                self.wfile.write(piece)
                request.sent += len(piece)
                if fault.cut_at is not None and at + 4096 >= fault.cut_at:
                    self.close_connection = True
                    return
                if fault.stall_at is not None and at + 4096 >= fault.stall_at:
                    recorder.stopping.wait(60)
                    self.close_connection = True
                    return

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    recorder.port = server.server_port
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield recorder
    finally:
        recorder.stopping.set()
        server.shutdown()
        server.server_close()
        thread.join()


def forwarding(port: int) -> Callable[[Request, bytes], Answer]:
    """Hands requests on to another server on this machine."""

    def upstream(request: Request, body: bytes) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", port)
        try:
            kept = {k: v for k, v in request.headers.items() if k != "connection"}
            connection.request(request.method, request.path, body, kept)
            found = connection.getresponse()
            data = found.read()
            skipped = ("transfer-encoding", "connection", "date", "server")
            headers = {k.title(): v for k, v in found.getheaders() if k.lower() not in skipped}
            return Answer(found.status, headers, data)
        finally:
            connection.close()

    return upstream


def files(contents: dict[str, bytes]) -> Callable[[Request, bytes], Answer]:
    """A web server that knows ranges. contents: by path, without what is behind `?`."""

    def upstream(request: Request, body: bytes) -> Answer:
        data = contents.get(unquote(request.path.partition("?")[0]))
        if data is None:
            return Answer(404, {}, b"not here")
        tag = f'"{zlib.crc32(data)}"'
        if request.headers.get("if-match", tag) != tag:
            return Answer(412, {}, b"")
        headers = {"ETag": tag, "Last-Modified": "Mon, 01 Jan 2024 00:00:00 GMT"}
        if not request.range:
            return Answer(200, headers, data)
        first, last = request.range.removeprefix("bytes=").split("-")
        start = max(0, len(data) - int(last)) if not first else int(first)
        stop = len(data) if not (first and last) else min(int(last) + 1, len(data))
        if start >= stop:
            return Answer(416, {}, b"")
        headers["Content-Range"] = f"bytes {start}-{stop - 1}/{len(data)}"
        return Answer(206, headers, data[start:stop])

    return upstream
