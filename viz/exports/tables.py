"""The junctions and the corridors of a map as two CSV tables."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import numpy as np

from ...topology.digits import significant
from ...topology.document import map_to_document
from ...topology.topomap import TopoMap
from ...topology.wording import quoted_formula
from .route_graph import driving_seconds, driving_speed, gone_properties, seconds_sigma


def junctions_csv(topomap: TopoMap) -> str:
    """A row for each vertex, in metres, radians and seconds since 1970; lists are separated by
    blanks. junction: of a site, the number in pictures and in the merged document."""
    document, rows = map_to_document(topomap), []
    for node in document["nodes"]:
        seen = [o["time_ns"] for o in node["observations"]]
        rows.append(
            {
                "id": node["id"],
                "x": node["x"],
                "y": node["y"],
                "sigma_m": node.get("sigma_m", ""),
                "kind": quoted_formula(node["kind"]),
                "branches": " ".join(f"{b:g}" for b in node["branches"]),
                "confidence": node.get("confidence", 1),
                "passes": len(seen),
                "first_pass_s": seconds_text(min(seen)) if seen else "",
                "last_pass_s": seconds_text(max(seen)) if seen else "",
            }
        )
    known = topomap.info.get("numbers")  # of a document it could be anything but a tuple
    if isinstance(known, tuple):
        rows = [{**row, "junction": number} for row, number in zip(rows, known, strict=True)]
    return _table(rows, topomap, "nodes")


def corridors_csv(topomap: TopoMap) -> str:
    """A row for each edge; `path` is a JSON list of points. `length_scale_sigma` is common to all
    lengths and the same in every row."""
    seconds, speed = driving_seconds(topomap), driving_speed(topomap)
    spread, scale = seconds_sigma(topomap), significant(topomap.measured.scale)
    gone = any(gone_properties(topomap, k) for k in range(len(topomap.source)))
    rows = [
        {
            "source": edge["source"],
            "target": edge["target"],
            "key": edge["key"],
            "length": edge["length"],
            "length_sigma": edge["length_sigma"],
            "length_scale_sigma": scale,
            "source_branch": _or_empty(edge["source_branch"]),
            "target_branch": _or_empty(edge["target_branch"]),
            "traversals": edge["traversals"],
            "seconds": f"{seconds[k]:.2f}" if np.isfinite(seconds[k]) else "",
            "seconds_sigma": f"{spread[k]:.2f}" if np.isfinite(spread[k]) else "",
            "speed_m_per_s": f"{speed[k]:.3f}" if np.isfinite(speed[k]) else "",
            "path": json.dumps(edge["path"]),
        }
        | ({"last_found": gone_properties(topomap, k).get("last_found", "")} if gone else {})
        for k, edge in enumerate(map_to_document(topomap)["edges"])
    ]
    return _table(rows, topomap, "edges")


def _or_empty(value: int | None) -> int | str:
    return "" if value is None else value


def seconds_text(time_ns: int) -> str:
    """A time in seconds, to the nanosecond."""
    sign = "-" if time_ns < 0 else ""
    return f"{sign}{abs(time_ns) // 10**9}.{abs(time_ns) % 10**9:09d}"


def _table(rows: list[dict[str, Any]], topomap: TopoMap, part: str) -> str:
    """The rows as CSV, with the members of a merged map's parts as JSON."""
    members = topomap.info.get("members", {}).get(part)
    if members:
        rows = [{**row, "members": json.dumps(of)} for row, of in zip(rows, members, strict=True)]
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]) if rows else ["id"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()
