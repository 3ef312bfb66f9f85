"""Packs of results: found by content, whole or not at all."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.cache import joined
from topobatch.merge.digests import digest_of
from topobatch.merge.packs import DamagedPackError, Pack, PackWriter

ERA = b"e" * 16
A, B, C = (letter * 16 for letter in (b"a", b"b", b"c"))


def written(*entries):
    out = PackWriter(ERA)
    for pair, kind, more in entries:
        out.add(pair, kind, **more)
    return out.pack()


SOME = (((A, B), 0, {"payload": b"one"}), ((A, C), 0, {"junctions": 3, "bits": -1.5}))


def told(pack):
    """{(digest, digest, kind): (junctions, bits, payload)}"""
    return {
        (pack.digests[r["a"]], pack.digests[r["b"]], int(r["kind"])): (
            int(r["junctions"]),
            float(r["bits"]),
            pack.payload(k) if r["size"] else b"",
        )
        for k, r in enumerate(pack.rows)
    }


def test_round_trip():
    pack = written(*SOME)
    again = Pack.from_bytes(pack.to_bytes())
    assert told(again) == {(A, B, 0): (0, 0.0, b"one"), (A, C, 0): (3, -1.5, b"")}
    assert again.to_bytes() == pack.to_bytes()


@pytest.mark.parametrize("bit", range(8))
def test_no_flipped_bit_gives_another_result(bit):
    data = written(*SOME).to_bytes()
    right = told(Pack.from_bytes(data))
    for k in range(len(data)):
        broken = bytearray(data)
        broken[k] ^= 1 << bit
        try:
            pack = Pack.from_bytes(bytes(broken))
        except DamagedPackError:
            continue
        for key, found in told(pack).items():
            assert found[2] is None or pack.era != ERA or found == right[key], k


def test_a_pack_that_is_cut_off_is_none():
    data = written(*SOME).to_bytes()
    for end in range(len(data)):
        with pytest.raises(DamagedPackError):
            Pack.from_bytes(data[:end])


def test_sizes_that_lie_allocate_nothing():
    data = bytearray(written(*SOME).to_bytes())
    data[24:32] = b"\xff" * 8
    with pytest.raises(DamagedPackError):
        Pack.from_bytes(bytes(data))


@pytest.mark.parametrize(
    ("field", "value"),
    [("a", 9), ("b", 2**32 - 1), ("start", 2**63), ("size", 2**64 - 1), ("bits", np.nan)],
)
def test_records_that_point_elsewhere_are_refused(field, value):
    """By whoever can write checksums, too."""
    pack = written(*SOME)
    rows = pack.rows.copy()
    rows[field][0] = value
    with pytest.raises(DamagedPackError):
        Pack.from_bytes(replace(pack, rows=rows).to_bytes())


def test_joined_keeps_what_is_wanted_once():
    other = written(((B, C), 0, {"payload": b"two"}), ((A, B), 0, {"payload": b"other"}))
    both = Pack.from_bytes(joined(ERA, [written(*SOME), other]).to_bytes())
    assert told(both) == {
        (A, B, 0): (0, 0.0, b"one"),
        (A, C, 0): (3, -1.5, b""),
        (B, C, 0): (0, 0.0, b"two"),
    }
    some = joined(ERA, [both], frozenset({B, C}))
    assert told(some) == {(B, C, 0): (0, 0.0, b"two")}
    assert some.payloads == b"two"


def test_the_digest_is_that_of_the_content(halves):
    one, other = halves
    assert digest_of(one) == digest_of(replace(one, run="renamed", info={}))
    assert digest_of(one) != digest_of(other)
    assert digest_of(one) != digest_of(replace(one, length=one.length + 0.001))
    assert digest_of(one) != digest_of(replace(one, noise=replace(one.noise, scale=0.006)))
    bent = (one.paths[0] + [[0.0, 0.001]] * len(one.paths[0]), *one.paths[1:])
    assert digest_of(one) != digest_of(replace(one, paths=bent))


def test_a_pack_in_a_file_reads_what_is_asked_for_and_closes_it(tmp_path):
    pack = written(*SOME)
    path = tmp_path / "some.pack"
    path.write_bytes(pack.to_bytes())
    file = path.open("rb")
    again = Pack.of_file(file)
    assert told(again) == told(pack)
    assert again.to_bytes() == pack.to_bytes()
    assert joined(ERA, [again]).to_bytes() == pack.to_bytes()
    with path.open("r+b") as other:
        other.seek(-1, 2)
        other.write(b"!")
    assert again.payload(0) is None
    del again
    assert file.closed


def test_a_file_that_is_cut_off_is_no_pack(tmp_path):
    data = written(*SOME).to_bytes()
    path = tmp_path / "some.pack"
    for end in (0, 20, len(data) - 1):
        path.write_bytes(data[:end])
        with path.open("rb") as file, pytest.raises(DamagedPackError):
            Pack.of_file(file)
