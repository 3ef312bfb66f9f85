"""Files and message count of a ROS 2 bag's metadata.yaml, parsed line by line.

Only the YAML that rosbag2 and its converters write is supported: block mappings, lists, plain and
quoted names; a document in braces is parsed as JSON. Without aliases, merge keys and tags the
parsed data are no larger than the file. O(bytes).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any, NamedTuple

from .messages import NAME_BYTES, printable

BAG_INFORMATION = "rosbag2_bagfile_information"
METADATA_BYTES = 1 << 22
"""Largest file that is read; a thousand topics and files take 1 MiB."""

_KEY = re.compile(r"""^(["']?)(?P<key>[A-Za-z0-9_]+)\1\s*:(\s+(?P<value>.*))?$""")
_QUOTED = re.compile(r"""^("(?:[^"\\]|\\.)*"|'(?:[^']|'')*')\s*(#.*)?$""")
_STRANGE = frozenset("&*!|>%@`[]{},")
"""Characters with which plain names do not begin."""


class Metadata(NamedTuple):
    """files: names without folders, in order; messages: their number, None if unknown."""

    files: list[str]
    messages: int | None


def parse_metadata(text: str) -> Metadata:
    """The files and the count in a metadata.yaml; raises ValueError if there are none."""
    if text.lstrip().startswith("{"):
        return _from_json(text)
    files: list[str] | None = None
    messages = None
    lines = list(_information(text))
    for number, (indent, line) in enumerate(lines):
        key = _KEY.match(line)
        if key is None or indent != lines[0][0] or line.startswith("- "):
            continue
        value = (key["value"] or "").strip()
        if key["key"] == "message_count":
            messages = _count(value)
        elif key["key"] == "relative_file_paths":
            files = _flow(value) if value.startswith("[") else _items(lines, number)
    if files is None:
        raise ValueError("it lists no files")
    return Metadata([_name(file) for file in files], messages)


def _from_json(text: str) -> Metadata:
    try:
        information = json.loads(text)[BAG_INFORMATION]
        files, messages = information["relative_file_paths"], information.get("message_count")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError("it is not the metadata of a bag") from error
    if not isinstance(files, list) or not all(isinstance(file, str) for file in files):
        raise ValueError("its list of files is none")
    return Metadata([_name(file) for file in files], _count(messages))


def _information(text: str) -> Iterator[tuple[int, str]]:
    """Indentation and content of the lines in the bag's information."""
    inside = False
    for raw in text.splitlines():
        line = raw.strip()
        if not line or line.startswith("#"):
            continue
        indent = len(raw) - len(raw.lstrip(" "))
        if indent == 0 and not (inside and line.startswith("- ")):
            key = _KEY.match(line)
            inside = key is not None and key["key"] == BAG_INFORMATION and not key["value"]
        elif inside:
            yield indent, line


def _items(lines: list[tuple[int, str]], at: int) -> list[str]:
    """The list under the key in line `at`."""
    out = []
    for indent, line in lines[at + 1 :]:
        if indent < lines[at][0] or not line.startswith("- "):
            break
        out.append(_scalar(line[2:].strip()))
    return out


def _flow(value: str) -> list[str]:
    """A list in brackets on one line."""
    inner = re.sub(r"\s#.*$", "", value).strip()
    if not inner.endswith("]"):
        raise ValueError("its list of files is none")
    return [_scalar(item.strip()) for item in inner[1:-1].split(",") if item.strip()]


def _scalar(value: str) -> str:
    """A plain or quoted name; raises ValueError for anything else."""
    quoted = _QUOTED.match(value)
    if quoted is not None:
        inner = quoted[1]
        if inner[0] == "'":
            return inner[1:-1].replace("''", "'")
        return str(json.loads(inner, strict=False))
    if not value or value[0] in _STRANGE or value[0] in "\"'":
        raise ValueError("a file's name is no name")
    return re.sub(r"\s+#.*$", "", value)


def _count(value: Any) -> int | None:
    """A number of messages, None for anything but a positive number."""
    if isinstance(value, str):
        value = int(value) if re.fullmatch(r"[0-9]{1,18}", value) else None
    whole = isinstance(value, int) and not isinstance(value, bool)
    return value if whole and 0 < value < 1 << 62 else None


def _name(path: str) -> str:
    return printable(PurePosixPath(path.replace("\\", "/")).name[:NAME_BYTES])
