"""Fused components as bytes, and found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.digests import digest_of
from topobatch.merge.document import places_text
from topobatch.merge.fusion import fuse as fusing
from topobatch.merge.fusion.component import from_bytes, to_bytes
from topobatch.merge.fusion.fuse import component_digest, fuse, fuse_component, fused_once
from topobatch.merge.packs import Kept, Kind
from topobatch.merge.result import Alignment, Late, PairVerdict, Verdict
from topobatch.merge.robust import DEFAULT_ROBUST, match, prepare


@pytest.fixture(scope="module")
def joined(halves):
    """Two maps of one building and the verdict that joins them."""
    a, b = sorted(halves, key=lambda m: m.run)
    best = match(prepare(a), prepare(b), DEFAULT_ROBUST)[0]
    alignment = Alignment(best.transform, 40.0, np.column_stack([best.a, best.b]), best.rmse_m)
    return [a, b], [PairVerdict(a.run, b.run, Verdict.MERGED, True, 40.0, "", best=alignment)]


def flat(value):
    """All that a component is made of."""
    if hasattr(value, "__dataclass_fields__"):
        return [x for name in value.__dataclass_fields__ for x in flat(getattr(value, name))]
    if isinstance(value, dict):
        return [x for key, part in value.items() for x in (key, *flat(part))]
    if isinstance(value, (tuple, Late)):
        return [x for part in value for x in flat(part)]
    return [np.asarray(value)]


def same(one, two):
    ones, twos = flat(one), flat(two)
    assert len(ones) == len(twos)
    for x, y in zip(ones, twos, strict=True):
        assert np.asarray(x).dtype == np.asarray(y).dtype
        np.testing.assert_array_equal(x, y)


FIRST_WITH_SECOND = np.array([1])


@pytest.mark.parametrize("sure", [FIRST_WITH_SECOND, FIRST_WITH_SECOND[:0], None])
def test_a_component_is_the_same_to_the_last_bit(joined, sure):
    maps, inside = joined
    component = fuse_component(maps, inside, sure=sure)
    assert (component.spread is not None) == (sure is not None)
    same(from_bytes(to_bytes(component, maps), maps), component)


def test_no_bytes_reach_outside(joined):
    """Cut off or overwritten, they are refused or make a component of these maps."""
    maps, inside = joined
    data = to_bytes(fuse_component(maps, inside, sure=FIRST_WITH_SECOND), maps)
    for end in range(0, len(data), 997):
        assert from_bytes(data[:end], maps) is None
    rng, read = np.random.default_rng(5), 0
    spots = [*range(0, 400, 8), *(8 * rng.integers(len(data) // 8, size=150)).tolist()]
    for at in spots:
        for junk in (b"\xff" * 8, b"\xff" * 7 + b"\x7f", b"\0" * 8):
            found = from_bytes(data[:at] + junk + data[at + 8 :], maps)
            if found is not None:
                for run, vertices in (i for own in found.fused.members for i in own.items()):
                    assert max(vertices) < len(next(m for m in maps if m.run == run))
                assert found.fused.source.max() < len(found.fused)
                read += 1
    assert read > 0


def test_maps_of_other_sizes_are_refused(joined):
    maps, inside = joined
    data = to_bytes(fuse_component(maps, inside), maps)
    assert from_bytes(data, [maps[0], maps[0]]) is None
    assert from_bytes(data, maps[:1]) is None


def test_what_was_fused_is_not_fused_again(joined, monkeypatch, new_store):
    maps, inside = joined
    kept = Kept(new_store())
    first = fuse(maps, inside, asked=(), kept=kept)
    (component,), fused = first
    assert component.text == places_text(fused)
    same(((replace(component, text=b""),), fused), fuse(maps, inside, asked=()))
    monkeypatch.setattr(fusing, "fuse_component", None)
    same(fuse(maps, inside, asked=(), kept=kept), first)
    renamed = [replace(m, run=f"x{m.run}") for m in maps]
    other = replace(inside[0], a=renamed[0].run, b=renamed[1].run, evidence_bits=31.0)
    poses = fuse(renamed, [other], asked=(), kept=kept)[0][0].poses
    assert sorted(poses) == [m.run for m in renamed]


def test_a_component_kept_with_other_pairs_is_fused_again(joined, new_store):
    """A record that somebody exchanged for one of fewer pairs leaves no pair without its sigma."""
    maps, inside = joined
    store, other = new_store(), new_store()
    first = fuse(maps, inside, asked=(), kept=Kept(store))
    fused_once(maps, inside, FIRST_WITH_SECOND[:0], Kept(other))
    (theirs,) = (payload for (kind, _), payload in other.known.items() if kind is Kind.COMPONENT)
    store.known = {k: theirs if k[0] is Kind.COMPONENT else v for k, v in store.known.items()}
    same(fuse(maps, inside, asked=(), kept=Kept(store)), first)


def test_a_component_is_known_by_all_that_it_follows_from(joined):
    (a, b), (verdict,) = joined
    digests = [digest_of(m) for m in (a, b)]
    plain = component_digest(digests, (a, b), [verdict])
    assert component_digest(digests[::-1], (a, b), [verdict]) != plain
    assert component_digest(digests, (a, b), []) != plain
    assert component_digest(digests, (a, b), [verdict], "other") != plain
    fewer = replace(verdict.best, matched=verdict.best.matched[:-1])
    assert component_digest(digests, (a, b), [replace(verdict, best=fewer)]) != plain


def test_what_is_behind_the_places_is_made_when_it_is_asked_for():
    asked = []
    late = Late(2, lambda: asked.append(1) or ("a", "b"))
    assert len(late) == 2
    assert not asked
    assert late == ("a", "b")
    assert late != ("a", "c")
    assert (late[1], late[:1], list(late)) == ("b", ("a",), ["a", "b"])
    assert len(asked) == 1
