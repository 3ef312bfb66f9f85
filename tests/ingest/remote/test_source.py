"""Parts of an object that are read ahead, and the blocks that are requested of it."""

from __future__ import annotations

from concurrent.futures import Future

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from topobatch.ingest.remote.source import BLOCK_BYTES, PART_BYTES, ReadAhead, RemoteFile
from topobatch.ingest.remote.store import Got, Stat

PARTS = [(0, 10), (20, 30), (40, 50), (60, 70)]
SIZE = 10_000_000
DATA = np.random.default_rng(1).integers(0, 256, SIZE, np.uint8).tobytes()

RANGES = st.lists(
    st.tuples(st.integers(0, SIZE - 400_000), st.integers(1, 300_000)).map(
        lambda r: (r[0], sum(r))
    ),
    min_size=1,
    max_size=20,
)


class Server:
    """What is asked of an object."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, int]] = []

    def __call__(self, part: tuple[int, int]) -> Future[Got]:
        self.asked.append(part)
        future: Future[Got] = Future()
        future.set_result(Got(part[0], DATA[slice(*part)], Stat(SIZE, "", 0)))
        return future


def test_parts_that_threads_want_out_of_turn_are_asked_for_once() -> None:
    server = Server()
    ahead = ReadAhead(PARTS, server)
    for wanted in (20, 0, 40, 60):
        found = ahead.at(wanted)
        assert found is not None
        assert found[:2] == (wanted, DATA[wanted : wanted + 10])
    assert sorted(server.asked) == PARTS
    assert ahead.at(25) is not None  # gone from memory: asked for again, alone
    assert len(server.asked) == len(PARTS) + 1


@given(RANGES, st.integers(1, 50_000))
def test_announced_ranges_are_read_in_few_requests_and_no_byte_twice(
    ranges: list[tuple[int, int]], tail: int
) -> None:
    server, stat = Server(), Stat(SIZE, "", 0)
    file = RemoteFile(SIZE, [Got(SIZE - tail, DATA[SIZE - tail :], stat)], server)
    cost = file.cost(ranges)
    with file.reading_ahead(ranges) as ahead:
        for first, stop in sorted(ranges):
            assert file.read(first, stop - first, ahead) == DATA[first:stop]
    assert sum(stop - first for first, stop in server.asked) == cost
    assert all(0 < stop - first <= PART_BYTES for first, stop in server.asked)
    count = np.zeros(SIZE, np.int8)
    for first, stop in [*server.asked, (SIZE - tail, SIZE)]:
        count[first:stop] += 1
    assert count.max() == 1
    wanted = np.zeros(SIZE, bool)
    for first, stop in ranges:
        wanted[first:stop] = True
    assert cost <= wanted.sum() + 2 * BLOCK_BYTES * len(ranges)
