"""Values as bytes and back to the last bit: tuples, mappings, numbers, texts, arrays, and
dataclasses of these.

    size of the text, 8 bytes
    JSON text: the value, with the type and shape of each array in its place
    the arrays, each from a multiple of 8 bytes on
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

SIZE = 8
"""Bytes of the size of the text, and of the steps in which the parts begin."""

ARRAY, MAPPING = "[]", "{}"
"""Mark arrays and mappings in the text, where names of classes mark dataclasses."""


def to_bytes(value: object) -> bytes:
    """A value as bytes. Raises TypeError for what is none of the above."""
    arrays: list[NDArray[Any]] = []
    text = json.dumps(_taken_apart(value, arrays), separators=(",", ":")).encode()
    parts = [text, *(array.tobytes() for array in arrays)]
    return b"".join(
        [len(text).to_bytes(SIZE, "little"), *(p + bytes(-len(p) % SIZE) for p in parts)]
    )


def from_bytes(data: bytes, classes: Mapping[str, type]) -> Any:
    """Inverse of `to_bytes`; sequences become tuples, arrays are read-only.

    classes: the dataclasses that may occur, by name. The bytes are trusted: a checksum tells
    whether they are whole.
    """
    start = SIZE + int.from_bytes(data[:SIZE], "little")
    at = start + -start % SIZE  # where the next array begins

    def value(form: Any) -> Any:
        """The value of which `_taken_apart` made this form."""
        nonlocal at
        if not isinstance(form, list):
            return form
        what, *parts = form
        if what == ARRAY:
            dtype, *shape = parts
            out = np.frombuffer(data, dtype, prod(shape), at).reshape(shape)
            at += out.nbytes + -out.nbytes % SIZE
            return out
        if what == MAPPING:
            return {key: value(part) for key, part in parts}
        values = map(value, parts)
        return classes[what](*values) if what else tuple(values)

    return value(json.loads(data[SIZE:start]))


def _taken_apart(value: object, arrays: list[NDArray[Any]]) -> object:
    """The form of a value in JSON, without its arrays, which are appended to `arrays`."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return [ARRAY, value.dtype.str, *value.shape]
    if isinstance(value, str | int | float | None):
        return value
    if isinstance(value, Mapping):
        return [MAPPING, *([key, _taken_apart(part, arrays)] for key, part in value.items())]
    if isinstance(value, Sequence):
        return [[], *(_taken_apart(part, arrays) for part in value)]
    if is_dataclass(value):
        parts = (getattr(value, field.name) for field in fields(value))
        return [type(value).__name__, *(_taken_apart(part, arrays) for part in parts)]
    raise TypeError(f"{type(value).__name__} has no form in bytes")
