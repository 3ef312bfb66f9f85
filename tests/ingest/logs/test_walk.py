"""Finding records by an index gives what a walk gives, or nothing."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from topobatch.ingest.logs.checksum import crc32
from topobatch.ingest.logs.columns import Shape, gather
from topobatch.ingest.logs.walk import bag_listed, bag_records, mcap_listed, mcap_records


def mcap_like(rng, count):
    """Records of a few sizes, the third of another kind, and the places of the messages."""
    out, places = b"", []
    for k in range(count):
        body = rng.bytes(int(rng.choice([22, 40, 755])))
        if k == 2:
            out += struct.pack("<BQ", 4, len(body)) + body
            continue
        places.append(len(out))
        out += struct.pack("<BQ", 5, len(body)) + body
    return np.frombuffer(out, np.uint8), np.array(places)


def bag_like(rng, count):
    out, places = b"", []
    for k in range(count):
        head, body = rng.bytes(40 if k != 2 else 55), rng.bytes(int(rng.choice([0, 40, 755])))
        if k != 2:
            places.append(len(out))
        out += struct.pack("<I", len(head)) + head + struct.pack("<I", len(body)) + body
    return np.frombuffer(out, np.uint8), np.array(places)


FORMATS = pytest.mark.parametrize(
    ("make", "listed", "walk"),
    [(mcap_like, mcap_listed, mcap_records), (bag_like, bag_listed, bag_records)],
    ids=["mcap", "bag"],
)


@FORMATS
def test_a_right_index_gives_every_record_in_any_order(make, listed, walk):
    rng = np.random.default_rng(3)
    data, places = make(rng, 60)
    expected, stop = walk(data)
    assert stop == len(data)
    assert len(expected) == 60
    np.testing.assert_array_equal(listed(data, rng.permutation(places)), expected)


@FORMATS
def test_an_index_that_forgets_some_messages_does_not_lose_them(make, listed, walk):
    data, places = make(np.random.default_rng(4), 60)
    keep = np.ones(len(places), bool)
    keep[[0, 7, 8, 30, len(places) - 1]] = False
    np.testing.assert_array_equal(listed(data, places[keep]), walk(data)[0])


@FORMATS
def test_a_wrong_index_is_not_believed(make, listed, walk):
    data, places = make(np.random.default_rng(5), 60)
    for k in (0, 5, len(places) - 1):
        for wrong in (places[k] + 1, places[k] - 1, len(data), 1 << 40, -1, places[k - 1]):
            changed = places.copy()
            changed[k] = wrong
            found = listed(data, changed)
            # A place listed twice, or one below 0 after sorting, leaves nothing to lean on.
            assert found is None or np.array_equal(found, walk(data)[0])
    assert listed(data[:-1], places) is None
    np.testing.assert_array_equal(listed(data, places[:3]), walk(data)[0])
    assert listed(data, np.zeros(0, np.int64)) is None


@pytest.mark.parametrize("length", [(1 << 64) - 9, (1 << 64) - 40, (1 << 63) - 1, 1 << 40])
def test_hostile_lengths_do_not_pass_for_records(length):
    data, places = mcap_like(np.random.default_rng(7), 60)
    data = data.copy()
    data[places[20] + 1 : places[20] + 9] = np.frombuffer(struct.pack("<Q", length), np.uint8)
    assert mcap_listed(data, places) is None


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


def test_the_checksum_is_the_usual_crc_and_can_be_continued():
    assert crc32(b"123456789") == 0xCBF43926
    assert crc32(b"6789", crc32(b"12345")) == 0xCBF43926
    assert crc32(np.frombuffer(b"123456789", np.uint8).data) == 0xCBF43926
