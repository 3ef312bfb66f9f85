"""Values as bytes, the same to the last bit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from topobatch.merge.codec import from_bytes, to_bytes
from topobatch.topology.ragged import Ragged


@dataclass(frozen=True)
class Some:
    name: str
    of: Ragged
    more: tuple[object, ...] = ()


@pytest.mark.parametrize("dtype", ["<f8", "<i8", "<c16", "|b1", "<u2"])
@pytest.mark.parametrize("shape", [(0,), (5,), (2, 3), (0, 2), (1, 2, 3), ()])
def test_arrays(dtype, shape):
    rng = np.random.default_rng(3)
    some = np.array(rng.normal(size=shape) * 9, dtype)
    values = some, np.arange(3), np.array([np.nan, -0.0])
    for value, again in zip(values, from_bytes(to_bytes(values), {}), strict=True):
        assert (again.dtype, again.shape) == (value.dtype, value.shape)
        assert again.tobytes() == value.tobytes()
        assert not again.flags.writeable
        assert again.flags.aligned


def test_only_named_classes_are_made():
    with pytest.raises(KeyError):
        from_bytes(to_bytes(Some("a", Ragged.from_rows([]))), {})
