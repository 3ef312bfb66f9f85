"""Making the merges of a workspace, with the names of their sites, and again where runs or names
changed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from ..merge.document import write_merged
from ..merge.result import MergeResult, fused_of, pairs_of
from ..merge.sites import Origin, SiteHistory, moved_sites, site_names
from ..topology.errors import DataError, DocumentError
from ..topology.files import write_together
from ..topology.topomap import TopoMap
from ..topology.wording import counted
from ..viz.pages import describe_pairs
from .matching import MatchOptions, kept_results, matching, read_maps, resumable, settings_of
from .output import progress, say, say_folded, warn
from .stale import contents
from .workspace import MERGED, Workspace

if TYPE_CHECKING:  # what takes a second to load
    from ..merge.merging import MergeSettings


def made(
    place: Workspace,
    maps: list[TopoMap],
    settings: MergeSettings,
    last: MergeResult | None,
    where: MatchOptions = MatchOptions(),  # noqa: B008 - frozen
    new: Mapping[str, str] = MappingProxyType({}),
) -> tuple[MergeResult, list[str]]:
    """Merge maps and write the files of the merge; and what became of the sites of the last one and
    of the numbers of their junctions. last: the merge whose sites keep their names; new: new names
    of runs since then. The caller holds the workspace's lock."""
    from ..merge.drives import drives
    from ..merge.merging import merge_maps
    from ..viz.merged_recording import write_merged_recording  # which loads rerun

    runs = [m.run for m in maps]
    kept = kept_results(place, settings.robust)
    with matching(place, pairs_of(len(maps)), kept, where) as means:
        result = merge_maps(
            maps, settings, locks=place.locks(), discarded=place.discards(), means=means
        )
    if settings.method == "robust" and runs == place.runs():
        kept.settle()
    # A run alone is a site of its own name, old or new.
    sites = {} if last is None else last.sites
    before = {new.get(run, run): new.get(site, site) for run, site in sites.items()}
    result = _with_sites(place, result, maps, before)
    moved = moved_sites(before, result.sites)
    if last is not None and place.merged_json.exists():
        now, then = fused_of(result.fused.members), fused_of(last.fused.members)
        if any(now.get((new.get(run, run), v), k) != k for (run, v), k in then.items()):
            moved.append("junctions of sites have other numbers now; draw and export them again")
    result = replace(result, info={**result.info, "maps": contents(place, runs)})
    with progress("writing", 0):
        write_together(
            {
                place.merged_json: partial(write_merged, result=result),
                place.merged_rrd: partial(
                    write_merged_recording, result=result, maps=maps, drives=drives(result)
                ),
            }
        )
    return result, moved


def made_again(
    place: Workspace, affected: Collection[str], new: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Repeat the merges that had one of the affected runs, each with the runs that still exist;
    new: new names of runs. The caller holds the workspace's lock."""
    with resumable(place.call("merge", "--all")):
        for each in place.merges():
            _repeat(each, affected, new)


def _repeat(place: Workspace, affected: Collection[str], new: Mapping[str, str]) -> None:
    """Repeat one merge; see `made_again`."""
    try:
        last = place.read_result()
        settings = settings_of(place, last)
    except DocumentError as error:
        warn(str(error))
        return
    if not last.home.keys() & set(affected):
        return
    runs = sorted({new.get(run, run) for run in last.home} & set(place.runs()))
    if not runs:
        place.merged_json.unlink()
        place.merged_rrd.unlink(missing_ok=True)
        say(f"{place.merged_json}: removed; none of its runs is left")
        return
    maps, _ = read_maps(place, runs)
    result, moved = made(place, maps, _about(settings, new, runs), last, new=new)
    name = "" if place.merge == MERGED else f", {place.merge}"
    say(f"merged again{name}: {counted(len(maps), 'run')}, {describe_pairs(result)}")
    for each in moved:
        say_folded(each)


def _about(settings: MergeSettings, new: Mapping[str, str], runs: Collection[str]) -> MergeSettings:
    """Settings with the meetings of these runs alone; new: new names of runs."""
    met = (
        replace(m, run_a=new.get(m.run_a, m.run_a), run_b=new.get(m.run_b, m.run_b))
        for m in settings.paper.meetings
    )
    kept = tuple(m for m in met if {m.run_a, m.run_b} <= set(runs))
    return replace(settings, paper=replace(settings.paper, meetings=kept))


def last_merge(place: Workspace) -> MergeResult | None:
    """The last merge of this name; where there is none that can be read, the usual one."""
    for each in (place, Workspace(place.root)):
        try:
            if (result := each.last_result()) is not None:
                return result
        except DataError:
            continue  # who reads it for its own sake is told
    return None


def _with_sites(
    place: Workspace, result: MergeResult, maps: Sequence[TopoMap], before: Mapping[str, str]
) -> MergeResult:
    """The merge with the names of its sites. before: the site of every run in the last one."""
    known = {run: site for run, site in before.items() if site}
    origins = {}
    for m in maps:
        # A log is known as long as the record of its ingest is there.
        times, log = m.observation_time_ns, place.ingested(m.run).log
        folder = (log or "").replace("\\", "/").split("/")[:-1]
        origins[m.run] = Origin(tuple(folder), int(times.min()) if len(times) else None)
    names = site_names(
        [sorted(c.poses) for c in result.components],
        SiteHistory(place.sites(), known),
        origins,
        {MERGED, *place.runs(), *(each.merge for each in place.merges())},
    )
    named = zip(result.components, names, strict=True)
    return replace(result, components=tuple(replace(c, site=name) for c, name in named))
