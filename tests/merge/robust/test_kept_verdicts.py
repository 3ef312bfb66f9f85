"""Verdicts of two maps alone, kept from merge to merge."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from topobatch.merge.digests import digest_of
from topobatch.merge.document import entry_of
from topobatch.merge.packs import Kind
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.merge.robust import DEFAULT_ROBUST
from topobatch.merge.robust.kept_verdicts import (
    NUMBERS,
    KeptVerdicts,
    entry_text,
    from_bytes,
    to_bytes,
)
from topobatch.merge.robust.repetition import default_copies
from topobatch.merge.robust.verdict import PairCount, threshold_for

COPIES, COUNT = default_copies(DEFAULT_ROBUST), PairCount(100, 3)


def aligned(bits, k=5):
    """An alignment with numbers that no document holds in full."""
    return Alignment(
        transform=np.array([1 / 3, -2e-7, np.pi / 7]),
        evidence_bits=bits,
        matched=np.column_stack([np.arange(k), np.arange(k)[::-1]]),
        rmse_m=np.sqrt(2) / 10,
        corridors=k - 1,
        contradictions=("door »ß« closed",),
        contradicting=(((1,), (2, 3)),),
    )


def verdicts(a, b):
    """One of each kind: unrelated; ambiguous, asked whether it may be a copy; merged."""
    best, second = aligned(20 / 3), aligned(1e-3, 4)
    extra = {"against_chance_bits": 12.34, "same_place_bits": 1.25}
    unclear = PairVerdict(
        a.run, b.run, Verdict.AMBIGUOUS, False, best.evidence_bits, "it may be",
        best=best, runner_up=second, margin_bits=1 / 7, advice="drive on", extra=extra,
        threshold_bits=np.log2(3e7),
    )  # fmt: skip
    nothing = PairVerdict(
        a.run, b.run, Verdict.UNRELATED, False, 0.1, "no", threshold_bits=np.log2(3e7)
    )
    merged = replace(
        unclear, verdict=Verdict.MERGED, accepted=True, accepted_by="pair", advice=None,
        runner_up=None, margin_bits=None, extra={"against_chance_bits": 12.34},
    )  # fmt: skip
    corroborated = replace(merged, accepted_by="runs", runner_up=second, margin_bits=-3.25)
    return [nothing, unclear, merged, corroborated]


@pytest.fixture(scope="module")
def pair(halves):
    return sorted(halves, key=lambda m: m.run)


def same(one, two):
    for field in fields(PairVerdict):
        x, y = getattr(one, field.name), getattr(two, field.name)
        if isinstance(x, Alignment):
            assert x.transform.tobytes() == y.transform.tobytes()
            np.testing.assert_array_equal(x.matched, y.matched)
            names = ("evidence_bits", "rmse_m", "corridors", "contradictions", "contradicting")
            assert [getattr(x, name) for name in names] == [getattr(y, name) for name in names]
        else:
            assert x == y, field.name


def test_verdicts_are_the_same_to_the_last_bit_and_so_are_their_entries(pair):
    for verdict in verdicts(*pair):
        data = to_bytes(verdict)
        same(from_bytes(data, *pair), verdict)
        assert json.loads(entry_text(data)) == json.loads(json.dumps(entry_of(verdict)))


def test_what_cannot_be_of_two_maps_is_refused(pair):
    a, b = pair
    nothing, unclear, merged, _ = verdicts(a, b)
    for one, two in ((b, a), (a, a), (replace(a, run="other"), b)):
        assert from_bytes(to_bytes(unclear), one, two) is None
    many = len(a) + len(b)
    for far in (
        replace(unclear.best, matched=np.array([[0, 0], [1, many]])),
        replace(unclear.best, matched=np.array([[many, 0], [1, 1]])),
        replace(unclear.best, contradicting=(((0,), (1, many)),)),
    ):
        assert from_bytes(to_bytes(replace(unclear, best=far)), a, b) is None
        assert from_bytes(to_bytes(replace(unclear, runner_up=far)), a, b) is None
    for strange in (
        replace(merged, accepted=False),
        replace(merged, accepted_by=None),
        replace(merged, accepted_by="lock"),
        replace(unclear, accepted=True),
        replace(unclear, accepted_by="pair"),
        replace(nothing, verdict=Verdict.AMBIGUOUS),
    ):
        assert from_bytes(to_bytes(strange), a, b) is None, strange


def test_no_bytes_do_harm(pair):
    """Cut off or overwritten, they are refused or give a verdict on these two maps."""
    a, b = pair
    data = to_bytes(verdicts(a, b)[1])
    assert all(from_bytes(data[:end], a, b) is None for end in range(0, len(data), 3))
    refused = 0
    for at in range(0, len(data) - 1, 2):
        for junk in (b"\xff\xff", b'""', b"99", b"]}"):
            found = from_bytes(data[:at] + junk + data[at + 2 :], a, b)
            refused += found is None
            if found is not None:
                assert (found.a, found.b) == (a.run, b.run)
                assert found.best.matched[:, 0].max() < len(a)
                assert found.best.matched[:, 1].max() < len(b)
    assert refused > len(data) / 4
    assert from_bytes(b"\xff" * 8 * NUMBERS + data[8 * NUMBERS :], a, b) is None  # no numbers


def kept_by(shelf, maps, count=COUNT, copies=COPIES, keys=None):
    threshold = threshold_for(count, copies, DEFAULT_ROBUST)
    digests = [digest_of(m) for m in maps]
    return KeptVerdicts(shelf, maps, digests, lambda _: threshold, {} if keys is None else keys)


def test_a_verdict_is_known_by_all_that_it_hangs_on(pair, new_store):
    nothing, unclear, *_ = verdicts(*pair)
    a, b = pair
    for verdict in (nothing, unclear):
        shelf = new_store()
        kept_by(shelf, pair).keep({(0, 1): verdict})
        same(kept_by(shelf, pair).find([(0, 1)])[0, 1], verdict)
        more = kept_by(shelf, pair, PairCount(10**6, 3))
        assert more.find([(0, 1)]) == {}
        assert kept_by(shelf, [a, replace(b, run="x")]).find([(0, 1)]) == {}
        other = replace(b, xy=b.xy + 1.0)
        assert kept_by(shelf, [a, other]).find([(0, 1)]) == {}
        assert kept_by(shelf, pair).find([(0, 1)], {(0, 1): 0}) == {}  # corroborated by a candidate
    # What copies look like matters only to those that were asked.
    for verdict, matters in ((nothing, False), (unclear, True)):
        shelf = new_store()
        kept_by(shelf, pair).keep({(0, 1): verdict})
        for changed in (
            kept_by(shelf, pair, PairCount(100, 90)),
            kept_by(shelf, pair, copies=replace(COPIES, change_rate=0.2)),
        ):
            assert bool(changed.find([(0, 1)])) != matters


def test_verdicts_of_one_merge_hang_on_their_own_buildings(pair, new_store):
    """As large a part is copied in both, but the copies differ."""
    shelf, unclear = new_store(), verdicts(*pair)[1]
    other = threshold_for(COUNT, replace(COPIES, change_rate=0.2), DEFAULT_ROBUST)
    kept = kept_by(shelf, pair)
    own = kept.threshold((0, 1))
    kept.keep({(0, 1): unclear})
    turning = iter([own, other, own])
    kept.threshold = lambda _: next(turning)
    assert [bool(kept.find([(0, 1)])) for _ in range(3)] == [True, False, True]


def test_what_is_kept_says_where_its_entry_is(pair, new_store):
    shelf, left, found = new_store(), {}, {}
    verdict = verdicts(*pair)[1]
    (held,) = kept_by(shelf, pair, keys=left).keep({(0, 1): verdict}).values()
    (again,) = kept_by(shelf, pair, keys=found).find([(0, 1)]).values()
    same(held, verdict)
    assert found[again] == left[held]
    assert json.loads(entry_text(shelf.find(Kind.VERDICT, found[again])))["b"] == pair[1].run


def test_alignments_made_late_are_alignments(pair):
    unclear = verdicts(*pair)[1]
    late = from_bytes(to_bytes(unclear), *pair).best
    assert isinstance(late, Alignment)
    changed = replace(late, corridors=99)
    assert changed.corridors == 99
    assert changed.matched.tolist() == unclear.best.matched.tolist()
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = late.nothing_of_the_kind


def test_matched_junctions_stand_where_the_entry_has_them(pair):
    """In the right order, and a reason that reads like them is left alone."""
    a, b = pair
    unclear = replace(verdicts(a, b)[1], reason='as "matched":[] says')
    data = to_bytes(unclear)
    assert (
        entry_text(data)
        == json.dumps(
            json.loads(entry_text(data)), separators=(",", ":"), ensure_ascii=False
        ).encode()
    )
    assert json.loads(entry_text(data)) == json.loads(json.dumps(entry_of(unclear)))
    start = len(data) - len(data[data.index(b'{"a"') :])
    for forged in (
        data[:start] + data[start:].replace(b'"matched":[]', b'"matched" :[]'),
        data[:start] + data[start:].replace(b'"matched":[]', b'"matched":[[0,1]]'),
        data[:start] + data[start:].replace(b'"matched":[],', b""),
    ):
        assert from_bytes(forged, a, b) is None
