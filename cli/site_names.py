"""The names of a merge's sites, from what the workspace remembers (`merge.sites`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..topology.errors import DataError, UsageError
from .workspace import MERGED, Workspace

if TYPE_CHECKING:
    from ..merge.result import MergeResult
    from ..merge.sites import Origin
    from ..topology.topomap import TopoMap


def sites_before(place: Workspace) -> dict[str, str]:
    """The site of every run in the last merge of this name; where there is none, in the usual one.
    A document that cannot be read names none."""
    from ..merge.document import read_merged

    for each in (place, Workspace(place.root)):
        try:
            if each.merged_json.is_file():
                return read_merged(each.merged_json).graph.sites
        except DataError:
            continue  # who reads it for its own sake is told
    return {}


def with_sites(
    place: Workspace, result: MergeResult, maps: Sequence[TopoMap], before: Mapping[str, str]
) -> tuple[MergeResult, list[str]]:
    """The merge with the names of its sites, and what became of those of the last one. before: the
    site of every run then."""
    from ..merge.sites import SiteHistory, site_names

    known = {run: site for run, site in before.items() if site}
    names, moved = site_names(
        [sorted(c.poses) for c in result.components],
        SiteHistory(place.sites(), known),
        {m.run: _origin(place, m) for m in maps},
        {MERGED, *place.runs(), *(each.merge for each in place.merges())},
    )
    named = zip(result.components, names, strict=True)
    return replace(result, components=tuple(replace(c, site=name) for c, name in named)), moved


def _origin(place: Workspace, topomap: TopoMap) -> Origin:
    """Where a run comes from; its log is known as long as the record of its ingest is there."""
    from ..merge.sites import Origin

    times = topomap.observation_time_ns
    first_ns = int(times.min()) if len(times) else None
    try:
        log = (place.ingested(topomap.run) or {}).get("log")
    except UsageError:  # a name that a file has, but that nothing of ours gave it
        log = None
    parts = log.replace("\\", "/").split("/") if isinstance(log, str) else []
    return Origin(tuple(parts[:-1]), first_ns)
