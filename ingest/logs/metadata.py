"""The YAML beside logs: metadata.yaml of a ROS 2 bag, and the description of a saved map.

Only what recorders and map savers write is supported: `key: value`, and lists in brackets or with
dashes. Without aliases, merge keys and tags the parsed data are no larger than the file. O(bytes).
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import NamedTuple

from ...topology.wording import legible
from .messages import NAME_BYTES

BAG_INFORMATION = "rosbag2_bagfile_information"
_LINE = re.compile(
    r"^(?P<indent> *)(?:(?P<dash>- +)|[\"']?(?P<key>[A-Za-z0-9_]+)[\"']?\s*:(?=\s|$))"
)
_STRANGE = frozenset("&*!|>%@`[]{},")
"""Characters with which plain names do not begin."""

_COMMENT = re.compile(r"(^|\s)#.*$")


class Metadata(NamedTuple):
    """files: names without folders, in order; messages: their number, None if unknown."""

    files: list[str]
    messages: int | None


def parse_metadata(text: str) -> Metadata:
    """The files and the count in a metadata.yaml; raises ValueError if there are none."""
    found = yaml_values(text, BAG_INFORMATION)
    files = [name for file in found.get("relative_file_paths", ()) if (name := _name(file))]
    if not files:
        raise ValueError("it lists no files")
    if any(file[0] in _STRANGE for file in files):
        raise ValueError("it names a file by what is no name")
    (count,) = found.get("message_count") or ("",)
    return Metadata(files, int(count) if re.fullmatch(r"[1-9][0-9]{0,17}", count) else None)


def yaml_values(text: str, below: str = "") -> dict[str, list[str]]:
    """The values of every key, as lists of texts; below: the key that holds them, "" for all."""
    out: dict[str, list[str]] = {}
    last: list[str] | None = None
    indent = 0 if not below else -1  # of the keys; -1: before those that are wanted
    inside = not below
    for line in text.splitlines():
        match = _LINE.match(line)
        if match is None:
            continue
        depth, value = len(match["indent"]), _COMMENT.sub("", line[match.end() :]).strip()
        if not inside:
            inside = depth == 0 and match["key"] == below and not value
        elif match["dash"]:
            if last is not None:
                last.append(_plain(value))
        elif indent < 0 < depth or depth == indent:
            indent = depth
            inner = value[1:].rstrip("]").split(",") if value.startswith("[") else [value]
            last = out[match["key"]] = [_plain(part) for part in inner if part.strip()]
        elif depth < indent or indent < 0:
            break
    return out


def _plain(value: str) -> str:
    """A name without its quotation marks."""
    value = value.strip()
    quoted = len(value) > 1 and value[0] == value[-1] and value[0] in "\"'"
    return value[1:-1].replace("''", "'") if quoted else value


def _name(path: str) -> str:
    return legible(PurePosixPath(path.replace("\\", "/")).name[:NAME_BYTES])
