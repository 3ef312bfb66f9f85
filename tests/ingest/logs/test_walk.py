"""Walking over records finds every one, whatever their sizes."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from topobatch.ingest.logs.columns import Shape, gather
from topobatch.ingest.logs.walk import bag_records, mcap_records


def mcap_like(rng, count):
    """Records of a few sizes, and their places."""
    out, places = b"", []
    for _ in range(count):
        body = rng.bytes(int(rng.choice([22, 40, 755])))
        places.append(len(out))
        out += struct.pack("<BQ", 5, len(body)) + body
    return np.frombuffer(out, np.uint8), places


def bag_like(rng, count):
    out, places = b"", []
    for _ in range(count):
        head, body = rng.bytes(40), rng.bytes(int(rng.choice([0, 40, 755])))
        places.append(len(out))
        out += struct.pack("<I", len(head)) + head + struct.pack("<I", len(body)) + body
    return np.frombuffer(out, np.uint8), places


@pytest.mark.parametrize(
    ("make", "walk"), [(mcap_like, mcap_records), (bag_like, bag_records)], ids=["mcap", "bag"]
)
def test_every_whole_record_is_found(make, walk):
    data, places = make(np.random.default_rng(3), 600)
    found, stop = walk(data)
    assert found.tolist() == places
    assert stop == len(data)
    found, stop = walk(data[: places[-1] + 5])
    assert found.tolist() == places[:-1]
    assert stop == places[-1]


@pytest.mark.parametrize("length", [(1 << 64) - 9, (1 << 64) - 40, (1 << 63) - 1, 1 << 40])
def test_hostile_lengths_do_not_pass_for_records(length):
    data, places = mcap_like(np.random.default_rng(7), 60)
    data = data.copy()
    data[places[20] + 1 : places[20] + 9] = np.frombuffer(struct.pack("<Q", length), np.uint8)
    assert mcap_records(data)[1] == places[20]


def test_rows_are_compared_in_the_fixed_bytes_alone():
    rng = np.random.default_rng(6)
    data = rng.integers(0, 256, 1000, np.uint8)
    start = np.array([3, 100, 979])
    head = data[3:24].copy()
    data[100:121], data[979:1000] = head, head
    data[100 + 5 : 100 + 9] += 1
    shape = Shape.of(head, ((0, 5), (9, 21)))
    rows = gather(data, start, 21)
    assert shape.misfits(rows) is None
    np.testing.assert_array_equal(rows[2, :21], head)
    for at, differs in ((4, True), (6, False), (20, True)):
        changed = rows.copy()
        changed[1, at] ^= 0x80
        wrong = shape.misfits(changed)
        assert (wrong is not None) == differs
        assert wrong is None or wrong.tolist() == [False, True, False]
