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


CLASSES = {"Some": Some, "Ragged": Ragged}


@pytest.mark.parametrize(
    "value",
    [
        (),
        ("one", 2, 0.1 + 0.2, True, None, ((), (3,))),
        {"a": (1, 2), "": {}},
        float("inf"),
    ],
)
def test_plain_values(value):
    assert from_bytes(to_bytes(value), {}) == value


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


def test_arrays_that_do_not_lie_in_a_row():
    values = np.arange(12.0).reshape(3, 4).T[::2]
    np.testing.assert_array_equal(from_bytes(to_bytes(values), {}), values)


def test_dataclasses():
    value = Some("a", Ragged.from_rows([[0.5], [], [1.5, 2.5]]), ({"b": np.arange(2)}, 7))
    again = from_bytes(to_bytes(value), CLASSES)
    assert (again.name, again.more[1]) == ("a", 7)
    assert [row.tolist() for row in again.of.take(range(3))] == [[0.5], [], [1.5, 2.5]]
    np.testing.assert_array_equal(again.more[0]["b"], np.arange(2))


def test_only_named_classes_are_made():
    with pytest.raises(KeyError):
        from_bytes(to_bytes(Some("a", Ragged.from_rows([]))), {})


def test_others_are_refused():
    with pytest.raises(TypeError, match="set has no form in bytes"):
        to_bytes({1, 2})
