"""Parts of an object that are read ahead."""

from __future__ import annotations

from concurrent.futures import Future

from topobatch.ingest.remote.source import ReadAhead
from topobatch.ingest.remote.store import Got, Stat

PARTS = [(0, 10), (20, 30), (40, 50), (60, 70)]


def test_parts_that_threads_want_out_of_turn_are_asked_for_once() -> None:
    asked: list[tuple[int, int]] = []

    def ask(part: tuple[int, int]) -> Future[Got]:
        asked.append(part)
        future: Future[Got] = Future()
        future.set_result(Got(part[0], bytes(part[1] - part[0]), Stat(100, "", 0)))
        return future

    ahead = ReadAhead(PARTS, ask)
    for wanted in (20, 0, 40, 60):
        assert ahead.at(wanted) == (wanted, bytes(10))
    assert sorted(asked) == PARTS
    assert ahead.at(25) == (20, bytes(10))  # gone from memory: asked for again, alone
    assert len(asked) == len(PARTS) + 1
