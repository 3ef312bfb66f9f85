"""Fused components as bytes, and found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.codec import from_bytes, to_bytes
from topobatch.merge.fusion import fuse as fusing
from topobatch.merge.fusion.fuse import CLASSES, component_digest, fuse, fuse_component
from topobatch.merge.kept import Kept
from topobatch.merge.result import Alignment, PairVerdict, Verdict
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
    if isinstance(value, tuple):
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
    same(from_bytes(to_bytes(component), CLASSES), component)


def test_what_was_fused_is_not_fused_again(joined, monkeypatch):
    maps, inside = joined
    kept = Kept()
    first = fuse(maps, inside, asked=(), kept=kept)
    same(first, fuse(maps, inside, asked=()))
    monkeypatch.setattr(fusing, "fuse_component", None)
    same(fuse(maps, inside, asked=(), kept=kept), first)


def test_a_component_is_known_by_all_that_it_follows_from(joined):
    maps, inside = joined
    kept, (verdict,) = Kept(), inside
    plain = component_digest(maps, inside, kept)
    assert component_digest(maps, [replace(verdict, evidence_bits=31.0)], kept) == plain
    assert component_digest(maps[::-1], inside, kept) != plain
    assert component_digest(maps, [], kept) != plain
    assert component_digest(maps, inside, kept, FIRST_WITH_SECOND) != plain
    renamed = [replace(m, run=f"x{m.run}") for m in maps]
    other = replace(verdict, a=renamed[0].run, b=renamed[1].run)
    assert component_digest(renamed, [other], kept) != plain
    fewer = replace(verdict.best, matched=verdict.best.matched[:-1])
    assert component_digest(maps, [replace(verdict, best=fewer)], kept) != plain
