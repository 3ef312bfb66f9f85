"""Checked, read-only arrays as fields of frozen dataclasses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray


def frozen_array(array: Any, dtype: Any, shape: tuple[int | None, ...], name: str) -> NDArray[Any]:
    """`array` as a read-only, C-contiguous array of the given dtype and shape, copied if needed.

    `None` in the shape stands for any length. Raises ValueError on another shape, on values that
    are not finite, and on fractions where integers are needed.
    """
    given = np.asarray(array)
    out = np.ascontiguousarray(given, dtype=dtype)
    if len(out.shape) != len(shape) or any(
        size not in (None, length) for size, length in zip(shape, out.shape, strict=True)
    ):
        raise ValueError(f"{name} has shape {out.shape}, expected {shape}")
    if out.dtype.kind == "f":
        if not np.isfinite(out).all():
            raise ValueError(f"{name} holds values that are not finite")
    elif given.dtype.kind == "f" and not np.array_equal(given, out):
        raise ValueError(f"{name} holds fractions where integers are needed")
    if out.flags.writeable:
        out = out.copy() if out is array or out.base is not None else out
        out.flags.writeable = False
    return out


def freeze(value: Any, dtype: Any, /, **shapes: tuple[int | None, ...]) -> None:
    """Replace fields of a frozen dataclass by their `frozen_array`, in `__post_init__`."""
    for name, shape in shapes.items():
        object.__setattr__(value, name, frozen_array(getattr(value, name), dtype, shape, name))


def frozen_rows(
    arrays: Sequence[Any], dtype: Any, columns: int, name: str
) -> tuple[NDArray[Any], ...]:
    """Arrays (k, columns) of different lengths, as views of one frozen array, so that many short
    ones are checked at once. Raises ValueError as `frozen_array` does."""
    given = [np.asarray(array) for array in arrays]
    for array in given:
        if array.ndim != 2 or array.shape[1] != columns:
            raise ValueError(f"{name} has shape {array.shape}, expected (None, {columns})")
    stops = np.cumsum([0, *map(len, given)]).tolist()
    joined = np.concatenate([np.zeros((0, columns), dtype), *given])
    whole = frozen_array(joined, dtype, (None, columns), name)
    return tuple(whole[start:stop] for start, stop in pairwise(stops))
