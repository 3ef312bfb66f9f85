"""YAML for other programs: the outer levels in block style, each inner value on one line as JSON.

JSON is valid YAML, and its strings are quoted, so that a run named `no` or `1e3` stays a string.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any


def yaml_text(document: Mapping[str, Any], depth: int) -> str:
    """A document with its first `depth` levels in block style and everything below them on one
    line."""
    return "".join(f"{line}\n" for line in _block(document, depth, ""))


def _block(value: Any, depth: int, indent: str) -> Iterator[str]:
    """The lines of a mapping or a list."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _entry(f"{indent}{_key(key)}:", inner, depth, indent)
    else:
        for inner in value:
            yield from _entry(f"{indent}-", inner, depth, indent)


def _key(name: str) -> str:
    """A key, quoted where YAML 1.1 might not read a string: `y` and `no` are booleans."""
    plain = len(name) > 3 and name.isidentifier() and name.casefold() not in ("true", "false")
    return name if plain else json.dumps(name, ensure_ascii=False)


def _entry(head: str, value: Any, depth: int, indent: str) -> Iterator[str]:
    """The lines of a value below its key or dash."""
    held = isinstance(value, (Mapping, Sequence)) and not isinstance(value, str)
    if held and value and depth > 1:
        yield head
        yield from _block(value, depth - 1, f"{indent}  ")
    else:
        yield f"{head} {json.dumps(value, ensure_ascii=False, allow_nan=False)}"
