"""Reading ahead on other threads: the order of the file, errors carried over, no thread left."""

from __future__ import annotations

import threading

import pytest

from topobatch.ingest.logs.ahead import AHEAD_BYTES, Ahead
from topobatch.ingest.logs.bag_file import BagFile
from topobatch.ingest.logs.mcap_file import McapFile
from topobatch.ingest.logs.messages import DamageError, Findings


def test_chunks_come_out_in_the_order_of_the_file():
    with Ahead[int]() as ahead:
        out = []
        for number in range(200):
            ahead.begin(number, lambda n=number: bytes([n]), AHEAD_BYTES // 5)
            assert ahead.last == number
            out += [(chunk, task()) for chunk, task in ahead.due()]
            assert number - len(out) < 6
        out += [(chunk, task()) for chunk, task in ahead.due(everything=True)]
        assert out == [(n, bytes([n])) for n in range(200)]
        assert ahead.last is None


def test_an_error_arrives_where_the_chunk_is_due():
    def fails() -> bytes:
        raise DamageError("broken")

    with Ahead[str]() as ahead:
        ahead.begin("good", lambda: b"1", 1)
        ahead.begin("bad", fails, 1)
        (_, good), (_, bad) = ahead.due(everything=True)
        assert good() == b"1"
        with pytest.raises(DamageError, match="broken"):
            bad()


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_no_thread_is_left_when_reading_is_given_up(logs, tmp_path, kind):
    if kind == "mcap":
        file = McapFile(logs.mcap(tmp_path / "a.mcap", logs.drive()))
    else:
        file = BagFile(logs.bag(tmp_path / "a.bag", logs.drive(), "bz2"))
    before = threading.active_count()
    blocks = file.blocks(lambda channel: 0, Findings())
    next(blocks)
    assert threading.active_count() > before
    blocks.close()
    assert threading.active_count() == before
